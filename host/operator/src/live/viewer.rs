//! The WebSocket protocol of robotics viewers (Foxglove WebSocket protocol, version 1): the server advertises
//! channels, the viewer subscribes to them, and messages come as binary frames. Only the reading part is
//! implemented; data that a viewer publishes are ignored.
//!
//! | topic | schema |
//! |---|---|
//! | `/joints` | `cubectl.Joints` |
//! | `/controller` | `cubectl.Controller` |
//! | `/tf` | `foxglove.FrameTransforms` |
//! | `/scene` | `foxglove.SceneUpdate` |
//! | `/events` | `foxglove.Log` |

use std::collections::BTreeMap;

use nalgebra::UnitQuaternion;
use robot_model::Pose;
use serde_json::{Value, json};

use super::events::EventView;
use super::state::Snapshot;
use crate::log::watch::Severity;
use crate::machine::{Machine, Placed, frame_of, link_pose, quaternion};

/// Protocols that are spoken, the newer name first.
pub const PROTOCOLS: [&str; 2] = ["foxglove.sdk.v1", "foxglove.websocket.v1"];

/// Opcode of a message: what follows is the number of the subscription, the time, the payload.
const MESSAGE: u8 = 1;
/// The bodies are sent again after this time, s: a viewer may have been started later.
const SCENE_EVERY_S: f64 = 1.0;

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Channel {
    Joints = 1,
    Controller = 2,
    Transforms = 3,
    Scene = 4,
    Events = 5,
}

const CHANNELS: [(Channel, &str, &str); 5] = [
    (Channel::Joints, "/joints", "cubectl.Joints"),
    (Channel::Controller, "/controller", "cubectl.Controller"),
    (Channel::Transforms, "/tf", "foxglove.FrameTransforms"),
    (Channel::Scene, "/scene", "foxglove.SceneUpdate"),
    (Channel::Events, "/events", "foxglove.Log"),
];

/// One viewer: what it subscribed to.
#[derive(Debug, Default)]
pub struct Viewer {
    subscriptions: BTreeMap<u32, Channel>,
    scene_sent_s: Option<f64>,
    last_event: u64,
}

impl Viewer {
    /// First message of the server.
    #[must_use]
    pub fn greeting(machine: &Machine) -> [String; 2] {
        let info = json!({
            "op": "serverInfo", "name": format!("cubectl: {}", machine.robot), "capabilities": [],
            "supportedEncodings": [], "metadata": {"version": env!("CARGO_PKG_VERSION")},
        });
        let channels: Vec<Value> = CHANNELS
            .iter()
            .map(|(channel, topic, schema)| {
                json!({
                    "id": *channel as u32, "topic": topic, "encoding": "json", "schemaName": schema,
                    "schemaEncoding": "jsonschema", "schema": json_schema(*channel).to_string(),
                })
            })
            .collect();
        [info.to_string(), json!({"op": "advertise", "channels": channels}).to_string()]
    }

    #[must_use]
    pub const fn last_event(&self) -> u64 {
        self.last_event
    }

    /// Takes a message of the viewer; an unknown one is ignored, as the protocol requires.
    pub fn take(&mut self, text: &str) {
        let Ok(said) = serde_json::from_str::<Value>(text) else { return };
        let number = |value: &Value| value.as_u64().and_then(|n| u32::try_from(n).ok());
        match said["op"].as_str() {
            Some("subscribe") => {
                for one in said["subscriptions"].as_array().into_iter().flatten() {
                    let channel = CHANNELS.iter().find(|row| number(&one["channelId"]) == Some(row.0 as u32));
                    if let (Some(id), Some((channel, ..))) = (number(&one["id"]), channel) {
                        self.subscriptions.insert(id, *channel);
                        self.scene_sent_s = None;
                    }
                }
            }
            Some("unsubscribe") => {
                for id in said["subscriptionIds"].as_array().into_iter().flatten().filter_map(number) {
                    self.subscriptions.remove(&id);
                }
            }
            _ => {}
        }
    }

    pub fn messages(&mut self, snapshot: &Snapshot, machine: &Machine) -> Vec<Vec<u8>> {
        let time = Time::of(snapshot);
        let scene_due = self.scene_sent_s.is_none_or(|sent_s| snapshot.t_s - sent_s >= SCENE_EVERY_S);
        let mut all = Vec::new();
        for (id, channel) in &self.subscriptions {
            let mut put = |value: &Value| all.push(frame(*id, time.ns(), value));
            match channel {
                Channel::Joints => put(&json!({"t_s": snapshot.t_s, "joints": snapshot.joints})),
                Channel::Controller => {
                    put(&json!({
                        "t_s": snapshot.t_s, "controller": snapshot.controller,
                        "load_percent": snapshot.load_percent, "bus_errors": snapshot.bus_errors,
                    }));
                }
                Channel::Transforms => {
                    if let Some(placed) = &snapshot.placed {
                        put(&transforms(placed, time));
                    }
                }
                Channel::Scene if scene_due => put(&scene(machine, time)),
                Channel::Scene => {}
                Channel::Events => {
                    for event in snapshot.events.iter().filter(|event| event.number > self.last_event) {
                        put(&log(event, time));
                    }
                }
            }
        }
        if scene_due {
            self.scene_sent_s = Some(snapshot.t_s);
        }
        self.last_event = snapshot.events.last().map_or(self.last_event, |event| event.number);
        all
    }
}

/// Time of a message: that of the wall clock where there is one.
#[derive(Clone, Copy)]
struct Time {
    us: u64,
}

impl Time {
    fn of(snapshot: &Snapshot) -> Self {
        let s = if snapshot.unix_s > 0.0 { snapshot.unix_s } else { snapshot.t_s };
        Self { us: (s.max(0.0) * 1e6) as u64 }
    }

    const fn ns(self) -> u64 {
        self.us.saturating_mul(1_000)
    }

    fn json(self) -> Value {
        json!({"sec": self.us / 1_000_000, "nsec": self.us % 1_000_000 * 1_000})
    }
}

fn frame(subscription: u32, time_ns: u64, payload: &Value) -> Vec<u8> {
    let mut bytes = vec![MESSAGE];
    bytes.extend(subscription.to_le_bytes());
    bytes.extend(time_ns.to_le_bytes());
    bytes.extend(payload.to_string().into_bytes());
    bytes
}

fn pose_of(rotation: &UnitQuaternion<f64>, p: [f64; 3]) -> (Value, Value) {
    let q = rotation.quaternion();
    (json!({"x": p[0], "y": p[1], "z": p[2]}), json!({"x": q.i, "y": q.j, "z": q.k, "w": q.w}))
}

fn transforms(placed: &Placed, time: Time) -> Value {
    let links = placed.links.iter().enumerate().map(|(i, x)| {
        let (p, rotation) = link_pose(x);
        let (translation, rotation) = pose_of(&rotation, p);
        json!({
            "timestamp": time.json(), "parent_frame_id": frame_of(0), "child_frame_id": frame_of(i + 1),
            "translation": translation, "rotation": rotation,
        })
    });
    json!({"transforms": links.collect::<Vec<_>>()})
}

fn scene(machine: &Machine, time: Time) -> Value {
    let entity = |(i, (link, x_lb, half_m)): (usize, &(usize, Pose, [f64; 3]))| {
        let (position, orientation) = pose_of(&quaternion(x_lb.rot), x_lb.pos.into());
        json!({
            "timestamp": time.json(), "frame_id": frame_of(*link), "id": format!("box {i}"),
            "lifetime": {"sec": 0, "nsec": 0}, "frame_locked": true, "metadata": [], "arrows": [], "spheres": [],
            "cylinders": [], "lines": [], "triangles": [], "texts": [], "models": [],
            "cubes": [{
                "pose": {"position": position, "orientation": orientation},
                "size": {"x": 2.0 * half_m[0], "y": 2.0 * half_m[1], "z": 2.0 * half_m[2]},
                "color": {"r": 0.56, "g": 0.63, "b": 0.71, "a": 1.0},
            }],
        })
    };
    json!({"deletions": [], "entities": machine.boxes.iter().enumerate().map(entity).collect::<Vec<_>>()})
}

fn log(event: &EventView, time: Time) -> Value {
    let level = match event.severity {
        Severity::Info => 2,
        Severity::Warning => 3,
        Severity::Error => 4,
    };
    json!({
        "timestamp": time.json(), "level": level, "message": event.text, "name": event.source, "file": "", "line": 0,
    })
}

/// Shapes of the messages; viewers know those of the `foxglove` schemas by their names.
fn json_schema(channel: Channel) -> Value {
    let object = |fields: Value| json!({"type": "object", "properties": fields});
    let list = |name: &str| json!({"type": "object", "properties": {name: {"type": "array", "items": {"type": "object"}}}});
    let number = json!({"type": "number"});
    match channel {
        Channel::Joints => object(json!({
            "t_s": number,
            "joints": {"type": "array", "items": object(json!({
                "name": {"type": "string"}, "q_rad": number, "qd_rad_s": number, "error_rad": number,
                "current_a": number, "state": {"type": "string"},
            }))},
        })),
        Channel::Controller => object(json!({
            "t_s": number, "load_percent": number, "bus_errors": number, "controller": {"type": "object"},
        })),
        Channel::Transforms => list("transforms"),
        Channel::Scene => list("entities"),
        Channel::Events => object(json!({
            "timestamp": {"type": "object"}, "level": number, "message": {"type": "string"}, "name": {"type": "string"},
        })),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::live::state::LiveState;
    use protocol::Duration;

    fn state() -> LiveState {
        let robot = robot_model::RobotModel::load("powercube6").unwrap();
        LiveState::new(Machine::of(&robot), Duration::from_secs(1_700_000_000), 1_000_000)
    }

    #[test]
    fn a_viewer_gets_the_channels_it_subscribed_to_with_its_own_numbers() {
        let state = state();
        let [info, advertised] = Viewer::greeting(state.machine());
        assert!(info.contains("\"op\":\"serverInfo\"") && info.contains("powercube6"), "{info}");
        let advertised: Value = serde_json::from_str(&advertised).unwrap();
        let ids: Vec<u64> =
            advertised["channels"].as_array().unwrap().iter().map(|c| c["id"].as_u64().unwrap()).collect();
        assert_eq!(ids, [1, 2, 3, 4, 5]);
        let mut viewer = Viewer::default();
        let mut snapshot = state.snapshot(0);
        assert!(viewer.messages(&snapshot, state.machine()).is_empty(), "nothing before a subscription");
        viewer.take(r#"{"op":"subscribe","subscriptions":[{"id":70,"channelId":1},{"id":71,"channelId":4},{"id":7,"channelId":99}]}"#);
        viewer.take("{not json");
        viewer.take(r#"{"op":"advertise","channels":[]}"#);
        let messages = viewer.messages(&snapshot, state.machine());
        assert_eq!(messages.len(), 2);
        for (message, id) in messages.iter().zip([70_u32, 71]) {
            assert_eq!((message[0], &message[1..5]), (1, &id.to_le_bytes()[..]));
            let ns = u64::from_le_bytes(message[5..13].try_into().unwrap());
            assert_eq!(ns / 1_000_000_000, 1_700_000_000, "time of the wall clock");
            serde_json::from_slice::<Value>(&message[13..]).unwrap();
        }
        let scene: Value = serde_json::from_slice(&messages[1][13..]).unwrap();
        assert_eq!(scene["entities"].as_array().unwrap().len(), state.machine().boxes.len());
        // The bodies do not change: they come again after a second.
        snapshot.t_s += 0.5;
        assert_eq!(viewer.messages(&snapshot, state.machine()).len(), 1);
        snapshot.t_s += 0.6;
        assert_eq!(viewer.messages(&snapshot, state.machine()).len(), 2);
        viewer.take(r#"{"op":"unsubscribe","subscriptionIds":[70,71]}"#);
        assert!(viewer.messages(&snapshot, state.machine()).is_empty());
    }

    #[test]
    fn transforms_place_every_link_where_the_kinematics_do() {
        let half = std::f64::consts::FRAC_1_SQRT_2;
        // A quarter turn about z, 1 m along x.
        let placed = Placed {
            links: vec![[0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.5]],
            hand_m: [0.0; 3],
        };
        let told = transforms(&placed, Time { us: 1_500_000 });
        let one = &told["transforms"][0];
        assert_eq!(
            (one["timestamp"]["sec"].as_u64(), one["timestamp"]["nsec"].as_u64()),
            (Some(1), Some(500_000_000))
        );
        assert_eq!((&one["parent_frame_id"], &one["child_frame_id"]), (&json!("world"), &json!("link1")));
        assert!((one["rotation"]["z"].as_f64().unwrap() - half).abs() < 1e-12);
        assert!((one["rotation"]["w"].as_f64().unwrap() - half).abs() < 1e-12);
        assert_eq!(one["translation"], json!({"x": 1.0, "y": 0.0, "z": 0.5}));
    }
}
