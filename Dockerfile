# docker build -t robustflow .                          the processor (the stage "cpu", which is the default)
# docker build -t robustflow:cuda --target cuda .       with PyTorch and its CUDA libraries, for hosts with NVIDIA's runtime
# docker run --rm -v "$PWD":/work robustflow run --model dis
# docker run --rm --gpus all -v "$PWD":/work robustflow:cuda run --model raft --checkpoint raft-things.pth --device cuda
ARG PYTHON_VERSION=3.11

FROM python:${PYTHON_VERSION}-slim AS wheel
WORKDIR /source
COPY pyproject.toml README.md LICENSE ./
COPY src src
RUN python -m pip wheel --no-cache-dir --no-deps --wheel-dir /wheels .

FROM python:${PYTHON_VERSION}-slim AS base
# Compiled kernels and drawn examples are cached in the home folder, which the user below owns.
ENV PYTHONUNBUFFERED=1 \
    NUMBA_CACHE_DIR=/home/robustflow/.cache/numba \
    MPLCONFIGDIR=/home/robustflow/.cache/matplotlib
COPY constraints.txt /opt/robustflow/constraints.txt
COPY --from=wheel /wheels /opt/robustflow/wheels
RUN python -m pip install --no-cache-dir -c /opt/robustflow/constraints.txt /opt/robustflow/wheels/*.whl \
    && useradd --create-home --uid 1000 robustflow \
    && install -d -o robustflow -g robustflow /work
WORKDIR /work
ENTRYPOINT ["robustflow"]
CMD ["--help"]

# PyTorch's wheels bring their own CUDA libraries: the host needs a driver and NVIDIA's container runtime, no more.
FROM base AS cuda
ARG EXTRAS=torch
RUN for wheel in /opt/robustflow/wheels/*.whl; do \
        python -m pip install --no-cache-dir -c /opt/robustflow/constraints.txt "${wheel}[${EXTRAS}]" || exit 1; \
    done
USER 1000

FROM base AS cpu
USER 1000
