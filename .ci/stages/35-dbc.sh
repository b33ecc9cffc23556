# The committed DBC file (generated: `cargo test` checks that) read by an independent program.
. .ci/venv.sh dbc tests/interop/dbc/requirements.txt
python tests/interop/dbc/check_dbc.py
