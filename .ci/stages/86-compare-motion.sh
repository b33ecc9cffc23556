# Ways and time laws of the Python package beside OMPL, toppra and ruckig, contacts by MuJoCo: a smaller sample than that of
# docs/measured/moving.md, which .ci/motion/run.sh measures.
. .ci/venv.sh motion .ci/motion/requirements.txt
out=target/compare-motion
rm -rf "$out" && mkdir -p "$out"
# As in the stage python, whose libraries it takes.
cargo build --quiet --workspace --locked --bin cubectl --example hello_drive
maturin build --quiet --locked --profile dev --features features-of-tests --manifest-path host/python/Cargo.toml --out "$out"
pip install --quiet --disable-pip-version-check --force-reinstall --no-deps "$out"/cubecell-*.whl
python .ci/motion/compare.py --moves 10 --paths 40 --points 100
