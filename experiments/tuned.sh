#!/usr/bin/env sh
# The README's table: the tuned preset on every task, ten demonstrations, three seeds; then 100
# episodes of each kept policy in Gymnasium itself.
#
# usage: experiments/tuned.sh [ENV ...]
set -eu
cd "$(dirname "$0")"
[ $# -gt 0 ] || set -- hopper swimmer halfcheetah walker2d
for env in "$@"; do
    ailsrs train "$env" --num-trajectories 10 --seeds 0 1 2 --output "tuned/$env"
    ailsrs evaluate "tuned/$env" --episodes 100 --json > "tuned/$env/evaluation.json"
    rm -r "tuned/$env/checkpoints"
done
