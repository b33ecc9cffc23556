# The generated DBC file read by an independent program.
. .ci/debug-build.sh
target/debug/examples/powercube_dbc >target/powercube.dbc
. .ci/venv.sh dbc tests/interop/dbc/requirements.txt
python tests/interop/dbc/check_dbc.py target/powercube.dbc
