#!/usr/bin/env bash
# Measure on a machine with an NVIDIA GPU, in at most 8 minutes.
#
# The machine has Python 3.12 and JAX 0.11 for CUDA 13, with flax, optax, orbax-checkpoint, scipy,
# rich, pillow and numba. The rest comes from wheels.sh.
#
# usage: experiments/gpu/measure.sh WHEELS OUTPUT.json [--tiny]
set -euo pipefail
cd "$(dirname "$0")/../.."
site=$(mktemp -d)
trap 'rm -rf "$site"' EXIT
python3 -m pip install --quiet --no-index --no-deps --no-compile --no-cache-dir \
    --target "$site" "$1"/*.whl
# The command of the package asks for its version: the metadata of an installed package.
metadata=$site/ailsrs_jax-0.dist-info
mkdir "$metadata"
printf 'Metadata-Version: 2.1\nName: ailsrs_jax\nVersion: 0\n' >"$metadata/METADATA"
export PYTHONPATH=$PWD:$site XDG_CACHE_HOME=$site/cache
python3 experiments/gpu/measure.py --output "$2" --seconds 450 "${@:3}"
