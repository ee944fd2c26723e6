# ailsrs with JAX on CUDA. Needs Docker and the NVIDIA container toolkit.
#
#   docker build --tag ailsrs .
#   docker run --rm --gpus all --user "$(id -u):$(id -g)" --volume "$PWD:/work" ailsrs train hopper
#
# JAX's wheels bring CUDA and cuDNN themselves; the driver is the host's. So the base is Python's
# image, not NVIDIA's. Without --gpus it trains on CPUs.

FROM python:3.11-slim-bookworm AS wheel
RUN pip install --no-cache-dir 'build>=1.2,<2'
WORKDIR /source
COPY pyproject.toml README.md LICENSE ./
COPY ailsrs_jax ailsrs_jax
RUN python -m build --wheel --outdir /dist

FROM python:3.11-slim-bookworm
# What the toolkit is to mount: CUDA, nvidia-smi, and EGL, which renders without a screen.
ENV NVIDIA_VISIBLE_DEVICES=all \
    NVIDIA_DRIVER_CAPABILITIES=compute,utility,graphics \
    HOME=/home/ailsrs
# Any user may keep caches there, whatever --user says.
RUN useradd --uid 1000 --no-create-home ailsrs && install --directory --mode 1777 "$HOME" /work
# The versions are those of Debian 12.
# hadolint ignore=DL3008
RUN apt-get update \
    && apt-get install --yes --no-install-recommends libegl1 libgl1 \
    && rm -rf /var/lib/apt/lists/*
COPY --from=wheel /dist /dist
# What is installed is the wheel, by its path; its metadata bound the versions of all else.
# hadolint ignore=DL3013
RUN set -- /dist/*.whl && pip install --no-cache-dir "$1[cuda,export,imitation,minari,plot,video]"
USER 1000
WORKDIR /work
ENTRYPOINT ["ailsrs"]
CMD ["--help"]
