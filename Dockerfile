# ailsrs with JAX on CUDA. You need Docker and the NVIDIA container toolkit.
#
#   docker build --tag ailsrs .
#   docker run --rm --gpus all --user "$(id -u):$(id -g)" --volume "$PWD:/work" ailsrs train hopper
#
# JAX's wheels contain CUDA and cuDNN, and the host provides the driver. So the base is Python's image,
# not NVIDIA's. Without --gpus it trains on CPUs.

FROM python:3.11-slim-bookworm AS wheel
RUN pip install --no-cache-dir 'build>=1.2,<2'
WORKDIR /source
COPY pyproject.toml README.md LICENSE ./
COPY ailsrs_jax ailsrs_jax
RUN python -m build --wheel --outdir /dist

FROM python:3.11-slim-bookworm
# The toolkit mounts these: CUDA, nvidia-smi, and EGL, which renders without a screen.
ENV NVIDIA_VISIBLE_DEVICES=all \
    NVIDIA_DRIVER_CAPABILITIES=compute,utility,graphics \
    HOME=/home/ailsrs
# Any user may keep caches here, because --user can name anyone.
RUN useradd --uid 1000 --no-create-home ailsrs && install --directory --mode 1777 "$HOME" /work
# Debian 12 fixes the versions.
# hadolint ignore=DL3008
RUN apt-get update \
    && apt-get install --yes --no-install-recommends libegl1 libgl1 \
    && rm -rf /var/lib/apt/lists/*
COPY --from=wheel /dist /dist
# This installs the wheel by its path; its metadata limit the versions of everything else.
# hadolint ignore=DL3013
RUN set -- /dist/*.whl && pip install --no-cache-dir "$1[cuda12,export,imitation,minari]"
USER 1000
WORKDIR /work
ENTRYPOINT ["ailsrs"]
CMD ["--help"]
