//! Rig of the integration suites (in work).
