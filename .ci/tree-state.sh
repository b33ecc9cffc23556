# Sourced by stages: a word for what is in the work tree, committed or not.
tree_state() { { git rev-parse HEAD; git diff HEAD; git ls-files --others --exclude-standard -z | xargs -0 -r cat; } | sha256sum; }
