# vhs on a CPU:   docker build -t vhs . && docker run -v "$PWD/runs:/work/runs" vhs train --config task2
# on a GPU:       docker build -t vhs-cuda . --build-arg BASE=nvidia/cuda:12.8.1-runtime-ubuntu24.04 \
#                   --build-arg TORCH=https://download.pytorch.org/whl/cu128
#                 docker run --gpus all -v "$PWD/runs:/work/runs" vhs-cuda train --config task2
ARG BASE=ubuntu:24.04

# Of an older Debian than BASE, so that the wheel finds its C library there.
FROM rust:1-slim-bookworm AS build
RUN apt-get update && apt-get install -y --no-install-recommends python3-venv && rm -rf /var/lib/apt/lists/*
RUN python3 -m venv /tools && /tools/bin/pip install --no-cache-dir "maturin>=1.9.4,<2"
WORKDIR /source
COPY . .
RUN /tools/bin/maturin build --release --out /dist

FROM ${BASE}
ARG TORCH=https://download.pytorch.org/whl/cpu
RUN apt-get update && apt-get install -y --no-install-recommends python3-venv && rm -rf /var/lib/apt/lists/*
RUN python3 -m venv /opt/vhs && /opt/vhs/bin/pip install --no-cache-dir torch --index-url ${TORCH}
COPY --from=build /dist /dist
RUN /opt/vhs/bin/pip install --no-cache-dir "$(ls /dist/*.whl)[report]"
ENV PATH=/opt/vhs/bin:$PATH
WORKDIR /work
ENTRYPOINT ["vhs"]
