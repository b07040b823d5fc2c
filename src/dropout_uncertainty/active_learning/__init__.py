"""Section 5.2: active learning with image data."""
