# The Python package: the wheel is built, installed into an environment of its own, and tested against `cubectl`; types are
# checked; the examples run.
. .ci/venv.sh python host/python/tests/requirements.txt
# With an example among the targets the libraries have the features that the tests give them: nothing is compiled again after
# the stage test, and without it no test program is linked.
cargo build --quiet --workspace --locked --bin cubectl --example hello_drive
out=target/python-stage
rm -rf "$out" && mkdir -p "$out"
cubectl=$PWD/target/debug/cubectl
# Profile and features of the tests, so that the libraries are there already. For use, a wheel is built with --release.
maturin build --quiet --locked --profile dev --features features-of-tests --manifest-path host/python/Cargo.toml --out "$out"
ls "$out"/cubecell-*-cp311-abi3-*.whl
pip install --quiet --disable-pip-version-check --force-reinstall --no-deps "$out"/cubecell-*.whl
CUBECTL=$cubectl pytest -q -p no:cacheprovider host/python/tests
mypy --strict --no-error-summary --cache-dir "$out/mypy" host/python/python/cubecell host/python/examples host/python/tests
# Each example ends with an error if what it shows does not hold.
python host/python/examples/reach.py 3
python host/python/examples/landings.py 3
python host/python/examples/follow_landings.py
python host/python/examples/catch_share.py 4
python host/python/examples/bus_look.py
python host/python/examples/pick_and_place.py
python host/python/examples/servo_keys.py sim wwwwwwddddddrrrrrrffffssssaaaa
"$cubectl" throw --target 1.0,1.0,-1.0 --out "$out/throw"
python host/python/examples/log_tables.py "$out/throw"
