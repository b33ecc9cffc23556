# The tables of docs/measured/moving.md with the full sample, 1000 moves. Not a stage: the stage compare-motion has a smaller one.
#   .ci/motion/run.sh [--moves N] [--paths N] [--points N] [--seed S]
set -euo pipefail
cd "$(dirname "$0")/../.."
. .ci/venv.sh motion .ci/motion/requirements.txt
maturin build --quiet --locked --release --manifest-path host/python/Cargo.toml --out target/motion
pip install --quiet --disable-pip-version-check --force-reinstall --no-deps target/motion/cubecell-*.whl
python .ci/motion/compare.py "$@"
