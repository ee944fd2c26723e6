#!/usr/bin/env bash
# Collect what a machine without network lacks (see measure.sh) as wheels for Python 3.12.
# usage: experiments/gpu/wheels.sh DIRECTORY
set -euo pipefail
platforms=()
for name in manylinux_2_28 manylinux_2_27 manylinux_2_17 manylinux2014 manylinux1; do
    platforms+=(--platform "${name}_x86_64")
done
python3 -m pip download --quiet --no-deps --only-binary=:all: --python-version 3.12 \
    --implementation cp "${platforms[@]}" --dest "$1" \
    mujoco==3.17.0 mujoco-mjx==3.17.0 glfw pyopengl websockets etils trimesh \
    'brax>=0.14.2,<0.15' flask flask-cors werkzeug blinker itsdangerous click \
    jaxopt jinja2 markupsafe ml-collections absl-py pyyaml \
    'gymnasium>=1.3,<1.5' cloudpickle farama-notifications imageio packaging \
    'tyro>=1.0,<2' docstring-parser typeguard typing-extensions \
    'tensorboardX>=2.6.2,<3' protobuf
size=$(du -sm "$1" | cut -f1)
echo "$(ls "$1" | wc -l) wheels, $size MiB"
if ((size > 64)); then
    echo "more than 64 MiB" >&2
    exit 1
fi
