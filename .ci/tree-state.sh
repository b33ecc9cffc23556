# Sourced by stages: a word for the sources in the work tree, committed or not. What programs write (recordings of throws)
# does not count.
tree_state() { { git rev-parse HEAD; git diff HEAD; git ls-files --others --exclude-standard -z -- '*.rs' '*.toml' | xargs -0 -r cat; } | sha256sum; }
