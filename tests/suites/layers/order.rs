//! The allowed order: what each package and each room may use. From the bottom to the top; whoever stands on a floor may
//! use the floors below it, and nothing on its own floor or above it.

/// Floors of packages.
pub(crate) const PACKAGES: &[&[&str]] = &[
    &["protocol", "toml-reader", "say"],
    &["can-link", "rsi-protocol", "tracker-protocol", "robot-model", "lapack-shim"],
    &["firmware", "hil-sim"],
    &["planner", "tuner"],
    &["operator"],
    &["host"],
    &["cell-tests"],
];

/// A folder with the floors of its rooms: the files and folders in it.
pub(crate) struct Folder {
    /// Path in the repository.
    pub(crate) path: &'static str,
    /// Floors of rooms, from the bottom to the top.
    pub(crate) floors: &'static [&'static [&'static str]],
}

/// Folders whose rooms are in order. A folder that is not here is not checked.
pub(crate) const FOLDERS: &[Folder] = &[
    Folder {
        path: "hil-sim/src",
        floors: &[
            &["bus", "rng", "witness"],
            &["fault", "mechanics"],
            &["crew"],
            &["drive", "world"],
            &["cell", "checker", "realtime", "record"],
            &["report", "scenario"],
            &["krc", "replay", "swarm", "tracker"],
            &["cmd"],
        ],
    },
    Folder {
        path: "host/planner/src",
        floors: &[&["throw"], &["flight", "solve", "store"], &["plan"], &["verify"], &["disc", "follow"]],
    },
    Folder { path: "host/tuner/src", floors: &[&["model"], &["gains", "identify"]] },
    Folder {
        path: "host/operator/src",
        floors: &[
            &["tap"],
            &["log", "node"],
            &["analysis", "bus"],
            &["dialogue"],
            &["identify", "throw"],
            &["rsi"],
        ],
    },
    Folder {
        path: "host/operator/src/bus",
        floors: &[
            &["entropy", "key_file", "settings", "storage"],
            &["failure", "seen", "pace"],
            &["period", "soft"],
            &["live", "sim"],
            &["session"],
            &["args"],
        ],
    },
    Folder { path: "host/operator/src/node", floors: &[&["drive_client", "inbox"], &["desk"]] },
    Folder { path: "host/src", floors: &[&["exit"], &["error"], &["report", "trust"], &["cmd"], &["cli"]] },
];
