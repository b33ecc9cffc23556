# Public arms from their URDF files: the table of docs/measured/arms.md. Not a stage: it loads 131 MB and takes half an hour.
#   .ci/arms/run.sh [--targets N] [--arm NAME ...]
set -euo pipefail
cd "$(dirname "$0")/../.."
. .ci/venv.sh arms .ci/arms/requirements.txt
cargo build --quiet --release --locked
robots=$(python -c 'import sysconfig; print(sysconfig.get_path("purelib"))')/cmeel.prefix/share/example-robot-data/robots
python .ci/arms/arms.py target/release/cubectl "$robots" target/arms "$@"
