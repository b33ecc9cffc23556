# Whether a ball that enters the cup stays in it: catches of the simulated cell, played again by MuJoCo. A smaller sample than that of
# docs/catching.md.
. .ci/venv.sh bounce .ci/bounce/requirements.txt
. .ci/debug-build.sh
python .ci/bounce/replay.py target/debug/cubectl hil-sim/src/two_arms/two_arms.toml robots/powercube6.toml --throws 24 --agree 0.95
