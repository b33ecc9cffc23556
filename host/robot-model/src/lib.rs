//! Robot arms from TOML (in work).
