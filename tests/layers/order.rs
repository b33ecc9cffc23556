//! The allowed order: what each package and each room may use. From the bottom to the top; whoever stands on a floor may
//! use the floors below it, and nothing on its own floor or above it.

/// Floors of packages.
pub(crate) const PACKAGES: &[&[&str]] = &[
    &["protocol", "toml-reader", "cell-console"],
    &["can-link", "rsi-protocol", "tracker-protocol", "robot-model", "lapack-shim", "throw-tables"],
    &["firmware", "hil-sim"],
    &["board-example", "planner", "tuner"],
    &["operator"],
    &["host"],
    &["cell-tests", "cubecell-python", "layers"],
];

/// A folder with the floors of its rooms: the files and folders in it.
pub(crate) struct Folder {
    /// Path in the repository.
    pub(crate) path: &'static str,
    /// Floors of rooms, from the bottom to the top.
    pub(crate) floors: &'static [&'static [&'static str]],
}

/// All folders in which rooms use each other.
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
        path: "protocol/src/cyphal",
        floors: &[
            &["bits", "crc", "id"],
            &["tx"],
            &["rx"],
            &["client", "uavcan"],
            &["cubecell", "server", "upload"],
            &["host"],
        ],
    },
    Folder {
        path: "protocol/src/cyphal/cubecell",
        floors: &[
            &["command", "group_state", "history", "joint_state", "stop", "target"],
            &["authorization"],
        ],
    },
    Folder {
        path: "protocol/src/cyphal/uavcan",
        floors: &[
            &["command", "diagnostic", "file", "heartbeat", "info", "port_list", "value"],
            &["register"],
        ],
    },
    Folder {
        path: "protocol/src/powercube",
        floors: &[
            &["address", "baud", "command", "firmware", "motion", "state"],
            &["broadcast", "config", "value"],
            &["parameter"],
            &["dbc", "request"],
            &["reply"],
        ],
    },
    Folder {
        path: "protocol/src/text",
        floors: &[&["buffer", "cursor"], &["candump", "slcan", "socketcand"]],
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
    Folder { path: "protocol/link/src/hub", floors: &[&["dialect", "options"], &["peer"]] },
    Folder {
        path: "protocol/rsi/src",
        floors: &[
            &["error", "generation", "names", "stream"],
            &["ipoc", "value", "xml"],
            &["telegram"],
            &["config"],
            &["robot", "sensor"],
        ],
    },
    Folder { path: "protocol/tracker/src", floors: &[&["pose"], &["dtrack", "vrpn"]] },
    Folder { path: "protocol/tracker/src/dtrack", floors: &[&["clock", "command"], &["data"]] },
    Folder {
        path: "robots/model/src",
        floors: &[
            &["cubic", "error", "fingers", "linalg", "mat3"],
            &["ik_solution", "pose"],
            &["boxes", "family"],
            &["model"],
            &["currents", "ik_axis", "kinematics", "load"],
            &["any", "collision", "dynamics", "ik", "jacobian", "release"],
            &["ik_numeric", "survey"],
            &["urdf"],
        ],
    },
    Folder { path: "robots/model/src/collision", floors: &[&["checker"], &["motion"]] },
    Folder {
        path: "robots/model/src/dynamics",
        floors: &[&["forward", "inverse", "spatial"], &["gradient"]],
    },
    Folder {
        path: "robots/model/src/family",
        floors: &[
            &["lines", "planar"],
            &["ortho_parallel", "turntable_planar"],
            &["ortho_parallel_axis", "ortho_parallel_ik"],
        ],
    },
    Folder {
        path: "robots/model/src/urdf",
        floors: &[&["export", "tree"], &["parts"], &["toml_text"], &["import"]],
    },
    Folder {
        path: "robots/reader/src",
        floors: &[&["bounded", "document_error", "write"], &["document"], &["section", "value"]],
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
        path: "firmware/src/controller",
        floors: &[
            &["arming", "authority", "cycle", "host", "report", "retargeting", "slow", "standing", "tracker"],
            &["starting", "stopping"],
        ],
    },
    Folder {
        path: "firmware/src/groups/powercube",
        floors: &[
            &["cycle_timing", "order", "ramp", "transmit", "words"],
            &["drive_model", "drives", "homing", "readiness", "slots"],
            &["finding", "jogging", "schedule"],
            &["cycle"],
            &["exchange"],
        ],
    },
    Folder {
        path: "firmware/src/groups/rsi",
        floors: &[&["events", "packet", "shape"], &["link", "model", "motion"]],
    },
    Folder { path: "firmware/src/host_link", floors: &[&["can_node", "history", "messages"], &["app"]] },
    Folder {
        path: "firmware/src/store",
        floors: &[&["storage"], &["seal"], &["key", "settings", "trajectories"]],
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
        path: "hil-sim/src/bus",
        floors: &[
            &["counters", "encode", "queue", "stats"],
            &["config", "event", "parse"],
            &["controller"],
            &["medium"],
            &["report"],
        ],
    },
    Folder { path: "hil-sim/src/cell", floors: &[&["finger_release"], &["faults", "throw"], &["build"]] },
    Folder {
        path: "hil-sim/src/cmd",
        floors: &[
            &["exit", "progress"],
            &["faults", "replay", "run", "serve", "serve_court", "serve_krc", "serve_tracker", "swarm"],
        ],
    },
    Folder {
        path: "hil-sim/src/drive",
        floors: &[
            &["homing", "options", "ramp"],
            &["program", "servo"],
            &["store"],
            &["state"],
            &["faults", "measure", "module", "obey", "supervise"],
        ],
    },
    Folder { path: "hil-sim/src/fault", floors: &[&["physical"], &["plan"], &["engine"]] },
    Folder {
        path: "hil-sim/src/krc",
        floors: &[
            &["event", "link", "options", "port", "state"],
            &["correction", "drives", "late", "monitor"],
            &["check", "hand"],
            &["controller"],
            &["bench"],
            &["scenario", "serve"],
        ],
    },
    Folder {
        path: "hil-sim/src/mechanics",
        floors: &[
            &["cup", "joint", "loose", "perturb", "plant", "supply"],
            &["ball", "rotation", "solver"],
            &["arm", "gripper"],
            &["options"],
        ],
    },
    Folder { path: "hil-sim/src/realtime", floors: &[&["door"], &["lockstep"]] },
    Folder {
        path: "hil-sim/src/scenario",
        floors: &[&["host", "values", "write"], &["build", "cell", "expect", "faults"]],
    },
    Folder {
        path: "hil-sim/src/tracker",
        floors: &[&["options"], &["scenario", "scene"], &["server"], &["serve"]],
    },
    Folder {
        path: "host/planner/src",
        floors: &[
            &["parallel", "throw"],
            &["flight", "motion", "solve", "store"],
            &["plan"],
            &["verify"],
            &["catch", "disc", "follow", "request"],
            &["record"],
        ],
    },
    Folder {
        path: "host/planner/src/catch",
        floors: &[
            &["draw", "forecast", "law"],
            &["arm", "task"],
            &["motion", "rates", "slot"],
            &["candidates"],
            &["edge"],
            &["search"],
            &["clear"],
            &["online"],
        ],
    },
    Folder {
        path: "host/planner/src/disc",
        floors: &[
            &["aero", "arm", "motion", "throw"],
            &["flight", "inverse", "screws"],
            &["estimate", "witness"],
            &["intercept", "paper"],
            &["online"],
        ],
    },
    Folder {
        path: "host/planner/src/flight",
        floors: &[&["aim", "model", "precession"], &["landing", "launch"]],
    },
    Folder {
        path: "host/planner/src/follow",
        floors: &[
            &["limits", "nearest", "parabola", "ramp"],
            &["hand"],
            &["posture"],
            &["motion"],
            &["clear", "landing"],
            &["found", "setting"],
            &["paper"],
            &["best"],
            &["plan"],
            &["search", "verify"],
        ],
    },
    Folder {
        path: "host/planner/src/follow/best",
        floors: &[&["variables"], &["excess"], &["least_squares", "seeds"]],
    },
    Folder {
        path: "host/planner/src/plan",
        floors: &[
            &["release_delays"],
            &["options", "rng", "seeds", "warm_start"],
            &["bounds", "disturbed"],
            &["problem"],
            &["layout", "margins", "obstruction", "opening", "posture"],
            &["cuts", "energy", "landed", "paper"],
            &["scan", "spread"],
            &["attitude", "statistics"],
            &["finger_release", "goal"],
            &["rows"],
            &["local"],
            &["basins", "planner"],
            &["continuation", "outcome", "place"],
            &["tighten"],
            &["nearest", "search"],
            &["library"],
            &["file", "ladder", "prepare"],
        ],
    },
    Folder { path: "host/planner/src/plan/file", floors: &[&["attitude", "motion"], &["compose", "io"]] },
    Folder {
        path: "host/planner/src/plan/rows",
        floors: &[
            &["arriving", "current", "delay", "goal", "spline"],
            &["attitude", "opening"],
            &["kinematic"],
        ],
    },
    Folder { path: "host/planner/src/solve", floors: &[&["qp"], &["rows"], &["curvature"], &["sqp"]] },
    Folder { path: "host/planner/src/store", floors: &[&["record"], &["file", "index"]] },
    Folder {
        path: "host/planner/src/verify",
        floors: &[
            &["boxes", "chain", "finding", "motion", "target"],
            &["attitude", "ball", "forces"],
            &["check"],
        ],
    },
    Folder {
        path: "host/tables/src",
        floors: &[&["error", "row", "shard"], &["part", "targets"], &["folder"], &["summary"]],
    },
    Folder { path: "host/tuner/src", floors: &[&["model"], &["gains", "identify"]] },
    Folder {
        path: "host/tuner/src/gains",
        floors: &[
            &["lmi", "lqr", "plant", "problem", "rigor"],
            &["law", "machine", "paper"],
            &["certificate"],
            &["evidence", "gains_file", "region"],
            &["saturated"],
            &["compare", "margins", "trial"],
            &["design"],
            &["choose", "picture"],
        ],
    },
    Folder {
        path: "host/tuner/src/identify",
        floors: &[
            &["noise", "student"],
            &["poses", "regression"],
            &["current", "lag"],
            &["samples"],
            &["findings"],
        ],
    },
    Folder {
        path: "host/operator/src",
        floors: &[
            &["interrupt", "machine", "tap"],
            &["log", "node"],
            &["bus", "samples"],
            &["analysis", "dialogue", "live"],
            &["port"],
            &["identify", "throw", "tracker"],
            &["disc", "flight_estimator", "rsi"],
            &["rally"],
        ],
    },
    Folder {
        path: "host/operator/src/analysis",
        floors: &[
            &["collect", "distribution", "events", "start"],
            &["bus", "control", "coverage", "timing"],
            &["tracking"],
            &["currents", "release"],
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
    Folder {
        path: "host/operator/src/dialogue",
        floors: &[
            &["ask", "following", "zero_check"],
            &["operator", "survey"],
            &["clock", "history", "homing", "online", "presence", "registers"],
            &["jogging", "key"],
        ],
    },
    Folder { path: "host/operator/src/flight_estimator", floors: &[&["fit", "stream"], &["watch"]] },
    Folder { path: "host/operator/src/identify", floors: &[&["experiment"], &["joint"]] },
    Folder { path: "host/operator/src/live", floors: &[&["gate", "state"], &["viewer"], &["serve"]] },
    Folder {
        path: "host/operator/src/log",
        floors: &[&["candump", "facts", "schema"], &["arm_view", "keep", "watch"], &["mcap"]],
    },
    Folder { path: "host/operator/src/node", floors: &[&["drive_client", "inbox"], &["host_node"]] },
    Folder {
        path: "host/operator/src/rally",
        floors: &[
            &["calibration", "estimator", "executor", "limits", "obstacles", "thrower", "told"],
            &["on_controller", "trial"],
            &["on_wire"],
            &["degraded", "failures", "throws"],
            &["exchange", "waiting"],
            &["study"],
        ],
    },
    Folder {
        path: "host/operator/src/rsi",
        floors: &[
            &["log", "plan", "wire"],
            &["cycles", "station"],
            &["cell", "identify", "live", "program", "replay"],
            &["outcome"],
        ],
    },
    Folder { path: "host/operator/src/samples", floors: &[&["drives"], &["of_log"]] },
    Folder {
        path: "host/operator/src/throw",
        floors: &[&["approach", "trajectory"], &["record"], &["job", "outcome"], &["summary"]],
    },
    Folder {
        path: "host/operator/src/tracker",
        floors: &[&["calibration", "commands", "target"], &["frames"], &["client"]],
    },
    Folder {
        path: "host/src",
        floors: &[&["exit"], &["error"], &["advice", "report", "trust"], &["cmd"], &["cli"], &["complete"]],
    },
    Folder {
        path: "host/src/cmd",
        floors: &[
            &[
                "bus_errors",
                "completions",
                "controlled",
                "export",
                "finding",
                "modules",
                "rally_on_wire",
                "robot",
                "swarm",
                "upload",
                "words",
            ],
            &[
                "check", "clear", "config", "home", "key", "man", "plan", "rally", "rsi", "scan", "stop",
                "tune",
            ],
            &[
                "catch",
                "doctor",
                "explain",
                "identify",
                "jog",
                "record",
                "registers",
                "report",
                "run",
                "sim_robot",
                "status",
                "tracker",
                "unlock",
            ],
            &["sim", "web"],
            &["monitor", "throw"],
            &["controller", "replay"],
        ],
    },
    Folder {
        path: "host/src/cmd/catch",
        floors: &[&["witness_words"], &["on_controller"], &["ball", "disc"], &["for_programs"]],
    },
    Folder { path: "host/src/cmd/monitor", floors: &[&["lines", "screen", "terminal"]] },
    Folder {
        path: "host/src/cmd/plan",
        floors: &[
            &["numbers"],
            &["attitude_options"],
            &["options"],
            &["follow_options", "grid", "prepare", "search"],
            &["shards"],
            &["args", "sweep"],
            &["follow", "targets"],
            &["for_programs", "throw"],
        ],
    },
    Folder { path: "host/src/cmd/registers", floors: &[&["value"], &["export", "get", "list"], &["set"]] },
    Folder {
        path: "host/src/cmd/throw",
        floors: &[&["folder", "last_look", "progress"], &["prepare"], &["robot"]],
    },
    Folder { path: "host/src/cmd/tune", floors: &[&["apply"], &["trial"]] },
    Folder {
        path: "host/src/report",
        floors: &[
            &["chart", "motion", "scene"],
            &["identify", "landing", "page", "reach", "robot", "timeline"],
            &["attitude"],
            &["catch", "follow", "live", "plan", "rally", "run"],
            &["industrial"],
        ],
    },
    Folder { path: "host/src/report/run", floors: &[&["bus", "record", "tracking"], &["early"]] },
    Folder {
        path: "host/src/trust",
        floors: &[&["evidence"], &["bench", "judge", "phases"], &["matrix", "swarm"], &["shrink"]],
    },
];
