# Sourced by stages: makes (once) and enters a Python environment with pinned packages. What is imported is compiled when
# it is, not all of it.
#   . .ci/venv.sh NAME REQUIREMENTS
venv=target/venv/$1
stamp=$venv/installed
if ! cmp -s "$2" "$stamp"; then
    rm -rf "$venv"
    python3 -m venv "$venv"
    "$venv/bin/pip" install --quiet --disable-pip-version-check --no-compile --requirement "$2"
    cp "$2" "$stamp"
fi
PATH=$PWD/$venv/bin:$PATH
