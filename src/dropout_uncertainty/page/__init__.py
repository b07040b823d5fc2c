"""The pages: tables, pictures, running the notebooks and building the book."""
