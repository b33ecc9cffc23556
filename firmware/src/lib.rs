//! Joint-group controller (in work): the sans-IO core comes first, boards wire it.
#![no_std]
