# The command torchreg in a container, with kernels for processors of the builder's kind.
#
# On the CPU. TORCH_INDEX is the index of PyTorch's CPU builds; without it, a bare torch brings gigabytes of CUDA
# libraries:
#   docker build --build-arg TORCH_INDEX=URL -t torchreg .
#   docker run --rm -v "$PWD:/scans" torchreg register a.ply b.ply --json ab.json
#
# On a GPU, over any image of CUDA's that stands on Debian or Ubuntu; torch brings the libraries itself:
#   docker build --build-arg BASE=nvidia/cuda:12.6.3-base-ubuntu24.04 -t torchreg:cuda .
#   docker run --rm --gpus all -v "$PWD:/scans" torchreg:cuda register a.ply b.ply --device cuda
ARG BASE=debian:bookworm-slim
FROM ${BASE}

# g++ builds the kernels; Open3D links against the last three.
RUN apt-get update \
    && DEBIAN_FRONTEND=noninteractive apt-get install -y --no-install-recommends \
        python3 python3-venv g++ libgl1 libgomp1 libx11-6 \
    && rm -rf /var/lib/apt/lists/*

RUN python3 -m venv /opt/torchreg
ENV PATH=/opt/torchreg/bin:$PATH

ARG TORCH_INDEX=
RUN pip install --no-cache-dir ${TORCH_INDEX:+--index-url "$TORCH_INDEX"} "torch>=2.6"

COPY pyproject.toml setup.py README.md LICENSE torchreg_command.py /src/
COPY torchreg /src/torchreg
RUN pip install --no-cache-dir /src && rm -rf /src

RUN useradd --create-home surveyor
USER surveyor
WORKDIR /scans
ENTRYPOINT ["torchreg"]
CMD ["--help"]
