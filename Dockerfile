# JupyterLab with the book's notebooks and everything they need:
#   docker build --tag dropout-uncertainty . && docker run --rm --publish 8888:8888 dropout-uncertainty
FROM debian:trixie AS system
RUN apt-get update \
 && apt-get install --yes --no-install-recommends python3 python3-venv make git ca-certificates \
 && rm -r /var/lib/apt/lists/*
RUN useradd --create-home reader
USER reader

FROM system
WORKDIR /home/reader/book
COPY --chown=reader . .
RUN make .venv/.ready
EXPOSE 8888
CMD [".venv/bin/jupyter", "lab", "--ip=0.0.0.0", "--no-browser", "notebooks"]
