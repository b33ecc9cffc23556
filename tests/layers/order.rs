//! The allowed order: what each package and each room may use. From the bottom to the top; whoever stands on a floor may
//! use the floors below it, and nothing on its own floor or above it.

/// Floors of packages.
pub(crate) const PACKAGES: &[&[&str]] = &[
    &["protocol", "toml-reader", "console"],
    &["can-link", "rsi-protocol", "tracker-protocol", "robot-model", "lapack-shim"],
    &["firmware", "hil-sim"],
    &["board-example", "planner", "tuner"],
    &["operator"],
    &["host"],
    &["cell-tests", "layers"],
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
        path: "protocol/src",
        floors: &[
            &["id", "module", "time", "units"],
            &["frame"],
            &["bits", "node", "powercube", "text"],
            &["cyphal"],
        ],
    },
    Folder {
        path: "protocol/link/src",
        floors: &[
            &["bus_error", "clock", "lateness", "stream", "urgent"],
            &["spec"],
            &["error"],
            &["link", "net", "serial"],
            &["hub", "runner", "socket_can", "station"],
            &["slcan", "socketcand"],
            &["open"],
        ],
    },
    Folder {
        path: "robots/model/src",
        floors: &[
            &["error", "linalg", "mat3"],
            &["ik_solution", "pose"],
            &["boxes", "family"],
            &["model"],
            &["currents", "ik_axis", "kinematics", "load"],
            &["any", "collision", "dynamics", "ik", "jacobian"],
            &["ik_numeric", "survey"],
            &["urdf"],
        ],
    },
    Folder {
        path: "firmware/src",
        floors: &[
            &["credentials", "crc", "events", "fault", "joints", "root", "span"],
            &["feedback", "gripper", "retarget"],
            &["settings", "spline"],
            &["envelope", "group", "path", "registers"],
            &["rest", "supervisor", "trajectory_format"],
            &["groups", "orders", "store"],
            &["authority", "trace"],
            &["state"],
            &["freeze", "telemetry"],
            &["controller"],
            &["host_link"],
            &["runner"],
        ],
    },
    Folder {
        path: "hil-sim/src",
        floors: &[
            &["bus", "rng", "witness"],
            &["fault", "mechanics"],
            &["participants"],
            &["drive", "world"],
            &["cell", "checker", "realtime", "record"],
            &["report", "scenario"],
            &["krc", "replay", "swarm", "tracker"],
            &["court"],
            &["cmd"],
        ],
    },
    Folder {
        path: "host/planner/src",
        floors: &[
            &["throw"],
            &["flight", "motion", "solve", "store"],
            &["plan"],
            &["verify"],
            &["catch", "disc", "follow"],
            &["record"],
        ],
    },
    Folder { path: "host/tuner/src", floors: &[&["model"], &["gains", "identify"]] },
    Folder {
        path: "host/operator/src",
        floors: &[
            &["tap"],
            &["log", "node"],
            &["bus", "samples"],
            &["analysis", "dialogue", "live"],
            &["port"],
            &["identify", "throw", "tracker"],
            &["flight_estimator", "rsi"],
            &["rally"],
        ],
    },
    Folder {
        path: "host/operator/src/bus",
        floors: &[
            &["entropy", "key_file", "settings", "storage"],
            &["failure", "seen", "cycle_timing"],
            &["period", "soft"],
            &["live", "sim"],
            &["session"],
            &["args"],
        ],
    },
    Folder { path: "host/operator/src/node", floors: &[&["drive_client", "inbox"], &["host_node"]] },
    Folder {
        path: "host/src",
        floors: &[&["exit"], &["error"], &["report", "trust"], &["cmd"], &["cli"], &["complete"]],
    },
];
