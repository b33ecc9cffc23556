//! True poses, and what the cameras make of them.

use protocol::Instant;
use tracker_protocol::dtrack::{Body, Marker};
use tracker_protocol::pose::columns_of_quaternion;

use super::options::{BodyOptions, TrackerFault, TrackerFaultKind, TrackerOptions};
use crate::rng::Rng;

/// Spheres of a body, in its frame, mm.
const SPHERES_MM: [[f64; 3]; 5] =
    [[0.0, 0.0, 0.0], [60.0, 0.0, 0.0], [0.0, 90.0, 0.0], [0.0, 0.0, 75.0], [40.0, 45.0, 30.0]];
/// False markers are within this distance from the origin, mm.
const ROOM_MM: f64 = 3000.0;

/// What one flash shows.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Seen {
    /// Recognised bodies.
    pub bodies: Vec<Body>,
    pub markers: Vec<Marker>,
    /// The datagram of this frame is lost.
    pub lost: bool,
    /// It comes later by this many microseconds.
    pub late_us: u64,
}

/// The bodies in the room and the cameras.
#[derive(Clone, Debug)]
pub struct Scene {
    bodies: Vec<BodyOptions>,
    noise_mm: f64,
    noise_deg: f64,
    faults: Vec<(TrackerFault, Rng)>,
    noise: Rng,
    places: Rng,
    next_marker: u32,
    /// Numbers of markers that were seen in the last frame, by what they are.
    known: Vec<((u32, usize), u32)>,
    /// Markers on no body, mm: where they are at the next flash.
    loose_mm: Vec<[f64; 3]>,
}

/// What a loose marker counts as among the bodies' spheres.
const LOOSE: u32 = u32::MAX - 1;

impl Scene {
    /// Each kind of chance has its own random stream.
    pub fn new(options: &TrackerOptions, seed: u64) -> Self {
        let stream = |(index, fault): (usize, &TrackerFault)| {
            (*fault, Rng::stream(seed, &format!("tracker fault {index}")))
        };
        Self {
            bodies: options.bodies.clone(),
            noise_mm: options.noise_mm,
            noise_deg: options.noise_deg,
            faults: options.faults.iter().enumerate().map(stream).collect(),
            noise: Rng::stream(seed, "tracker noise"),
            places: Rng::stream(seed, "tracker false markers"),
            next_marker: 1,
            known: Vec::new(),
            loose_mm: Vec::new(),
        }
    }

    /// Single markers that the next flash shows, mm in the room.
    pub fn place_markers(&mut self, at_mm: &[[f64; 3]]) {
        self.loose_mm.clear();
        self.loose_mm.extend_from_slice(at_mm);
    }

    /// True position (mm) and rotation of a body at `at`; `None` if the body does not exist.
    pub fn truth(&self, body: u32, at: Instant) -> Option<([f64; 3], [f64; 4])> {
        let motion = self.bodies.iter().find(|options| options.id == body)?.motion;
        let t = at.as_secs_f64();
        let turns = t / motion.swing_period.as_secs_f64().max(1e-6);
        let swing = libm::sin(core::f64::consts::TAU * turns);
        let mut position_mm = motion.position_mm;
        for (axis, x) in position_mm.iter_mut().enumerate() {
            *x += motion.velocity_mm_s[axis] * t + motion.swing_mm[axis] * swing;
        }
        for (fault, _) in self.faults.iter().filter(|(fault, _)| (fault.from..fault.until).contains(&at)) {
            if let TrackerFaultKind::Moved { body: moved, by_mm } = fault.kind
                && moved == body
            {
                for (x, by) in position_mm.iter_mut().zip(by_mm) {
                    *x += by;
                }
            }
        }
        Some((position_mm, motion.rotation_wxyz))
    }

    pub fn flash(&mut self, at: Instant) -> Seen {
        let mut seen = Seen::default();
        let (mut hidden, mut unrecognised, mut false_markers) = (Vec::new(), Vec::new(), 0);
        let mut bias_mm = [0.0; 3];
        for (fault, rng) in &mut self.faults {
            if !(fault.from..fault.until).contains(&at) || !rng.chance(fault.probability) {
                continue;
            }
            match fault.kind {
                TrackerFaultKind::Lost { body } => hidden.push(body),
                TrackerFaultKind::Unrecognised { body } => unrecognised.push(body),
                TrackerFaultKind::Bias { by_mm } => {
                    bias_mm.iter_mut().zip(by_mm).for_each(|(sum, by)| *sum += by);
                }
                TrackerFaultKind::FalseMarkers { count } => false_markers += count,
                TrackerFaultKind::FramesLost => seen.lost = true,
                TrackerFaultKind::Delayed { by } => seen.late_us += by.as_micros(),
                TrackerFaultKind::Moved { .. } | TrackerFaultKind::Restart => {}
            }
        }
        let mut known = Vec::new();
        for id in self.bodies.iter().map(|body| body.id).collect::<Vec<_>>() {
            let Some((position_mm, rotation)) = self.truth(id, at) else { continue };
            let measured = self.measure(&position_mm, &bias_mm);
            let rotation = columns_of_quaternion(self.turned(rotation));
            if hidden.contains(&id) {
                continue;
            }
            if unrecognised.contains(&id) {
                for (index, sphere) in SPHERES_MM.iter().enumerate() {
                    let position_mm = std::array::from_fn(|row| {
                        let turned: f64 =
                            (0..3).map(|column| rotation[3 * column + row] * sphere[column]).sum();
                        measured[row] + turned
                    });
                    seen.markers.push(self.marker((id, index), position_mm, &mut known));
                }
                continue;
            }
            let angles_deg = Some(angles_deg(&rotation));
            seen.bodies.push(Body { id, quality: 1.0, position_mm: measured, angles_deg, rotation });
        }
        for (index, position_mm) in self.loose_mm.clone().into_iter().enumerate() {
            let measured = self.measure(&position_mm, &bias_mm);
            seen.markers.push(self.marker((LOOSE, index), measured, &mut known));
        }
        for index in 0..false_markers {
            let position_mm = std::array::from_fn(|_| (2.0 * self.places.unit() - 1.0) * ROOM_MM);
            seen.markers.push(self.marker((u32::MAX, index as usize), position_mm, &mut known));
        }
        self.known = known;
        seen
    }

    /// A marker keeps its number while it is seen; after a loss it gets a new one.
    fn marker(
        &mut self,
        what: (u32, usize),
        position_mm: [f64; 3],
        known: &mut Vec<((u32, usize), u32)>,
    ) -> Marker {
        let before = self.known.iter().find(|(other, _)| *other == what).map(|(_, id)| *id);
        let id = before.unwrap_or(self.next_marker);
        if before.is_none() {
            self.next_marker = self.next_marker.wrapping_add(1).max(1);
        }
        known.push((what, id));
        Marker { id, quality: 1.0, position_mm }
    }

    fn measure(&mut self, position_mm: &[f64; 3], bias_mm: &[f64; 3]) -> [f64; 3] {
        std::array::from_fn(|axis| position_mm[axis] + bias_mm[axis] + self.noise_mm * self.noise.normal())
    }

    /// The rotation with noise: a small turn about a random axis of the body.
    fn turned(&mut self, [w, x, y, z]: [f64; 4]) -> [f64; 4] {
        let half = 0.5 * self.noise_deg.to_radians();
        let [a, b, c]: [f64; 3] = std::array::from_fn(|_| half * self.noise.normal());
        let q = [
            w - x * a - y * b - z * c,
            x + w * a + y * c - z * b,
            y + w * b + z * a - x * c,
            z + w * c + x * b - y * a,
        ];
        let norm = libm::sqrt(q.iter().map(|x| x * x).sum());
        q.map(|x| x / norm)
    }
}

/// Angles with `R = Rx(rx) Ry(ry) Rz(rz)` of a matrix given column by column.
fn angles_deg(b: &[f64; 9]) -> [f64; 3] {
    let rx = libm::atan2(-b[7], b[8]);
    let ry = libm::atan2(b[6], libm::hypot(b[0], b[3]));
    let rz = libm::atan2(-b[3], b[0]);
    [rx, ry, rz].map(f64::to_degrees)
}
