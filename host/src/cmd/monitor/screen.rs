//! The picture of `cubectl monitor` on a terminal: a snapshot and what came before it, as lines of a given size.

use std::collections::VecDeque;

use operator::live::state::{ControllerView, EventView, JointView, Snapshot};
use operator::log::watch::Severity;

/// Pictures kept for trends.
const KEPT: usize = 64;
/// A drive that has told nothing for this long is called silent, s.
const SILENT_S: f64 = 0.5;
const BARS: [char; 8] = ['▁', '▂', '▃', '▄', '▅', '▆', '▇', '█'];

/// Colour of a piece of text; words carry the meaning, colours only point at it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Colour {
    #[default]
    Plain,
    Faint,
    Good,
    Warning,
    Bad,
    Title,
}

impl Colour {
    const fn code(self) -> &'static str {
        match self {
            Self::Plain => "",
            Self::Faint => "\x1b[2m",
            Self::Good => "\x1b[32m",
            Self::Warning => "\x1b[33m",
            Self::Bad => "\x1b[1;31m",
            Self::Title => "\x1b[1m",
        }
    }
}

/// A line under construction: it never gets wider than the terminal.
#[derive(Debug, Default)]
struct Line {
    pieces: Vec<(Colour, String)>,
}

impl Line {
    fn add(mut self, colour: Colour, text: impl Into<String>) -> Self {
        self.pieces.push((colour, text.into()));
        self
    }

    fn plain(text: impl Into<String>) -> Self {
        Self::default().add(Colour::Plain, text)
    }

    /// The text, cut to `width` characters, with or without colours.
    fn text(&self, width: usize, colours: bool) -> String {
        let whole: usize = self.pieces.iter().map(|(_, text)| text.chars().count()).sum();
        // A mark stands for what is cut off.
        let mut left = if whole > width { width.saturating_sub(1) } else { width };
        let mut mark = (whole > width && width > 0).then_some('…');
        let mut out = String::new();
        for (colour, text) in &self.pieces {
            let mut cut: String = text.chars().take(left).collect();
            left -= cut.chars().count();
            if left == 0 && whole > width {
                cut.extend(mark.take());
            }
            if colours && *colour != Colour::Plain && !cut.is_empty() {
                out += &format!("{}{cut}\x1b[0m", colour.code());
            } else {
                out += &cut;
            }
        }
        out
    }
}

/// What trends are drawn from.
#[derive(Clone, Debug, Default)]
struct Series(VecDeque<Option<f64>>);

impl Series {
    fn push(&mut self, value: Option<f64>) {
        if self.0.len() == KEPT {
            self.0.pop_front();
        }
        self.0.push_back(value.filter(|value| value.is_finite()));
    }

    /// The last `width` values as bars between the smallest and the largest of them, `span` apart at least.
    fn bars(&self, width: usize, span: f64) -> String {
        let shown: Vec<Option<f64>> =
            self.0.iter().skip(self.0.len().saturating_sub(width)).copied().collect();
        let known = shown.iter().flatten();
        let low = known.clone().copied().fold(f64::INFINITY, f64::min);
        let high = known.copied().fold(f64::NEG_INFINITY, f64::max);
        let range = (high - low).max(span);
        let bar = |value: &Option<f64>| match value {
            Some(value) => BARS[((value - low) / range * 7.0).round().clamp(0.0, 7.0) as usize],
            None => ' ',
        };
        let text: String = shown.iter().map(bar).collect();
        format!("{text:>width$}")
    }
}

#[derive(Clone, Debug, Default)]
struct JointTrend {
    angle: Series,
    error: Series,
    current: Series,
}

/// A module that the robot file does not know.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Stranger {
    /// Address.
    pub(super) module: u8,
    /// Position, rad.
    pub(super) position_rad: Option<f64>,
    /// Motor current, A.
    pub(super) current_a: Option<f64>,
    /// State in words.
    pub(super) state: String,
}

/// How the picture is drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct View {
    /// Columns and rows of the terminal.
    pub(super) size: (usize, usize),
    pub(super) colours: bool,
    /// The picture is held.
    pub(super) held: bool,
    /// Events are shown.
    pub(super) events: bool,
    /// Time between two pictures, ms.
    pub(super) period_ms: u64,
    /// Told below the title: drives were halted from here.
    pub(super) stopped: Option<&'static str>,
}

/// What is shown, with its trends.
#[derive(Clone, Debug, Default)]
pub(super) struct Screen {
    load: Series,
    joints: Vec<JointTrend>,
    events: Vec<EventView>,
}

/// Columns of the table of joints that are left out on narrow terminals: the width they need.
const WITH_CURRENT: usize = 56;
const WITH_ERROR: usize = 68;
const WITH_SPEED: usize = 80;
const WITH_TRENDS: usize = 100;
const WITH_ALL_TRENDS: usize = 132;
const TREND: usize = 16;

impl Screen {
    /// Takes the next snapshot, with the events since the last one.
    pub(super) fn take(&mut self, snapshot: &Snapshot) {
        self.load.push(Some(snapshot.load_percent));
        self.joints.resize_with(snapshot.joints.len(), JointTrend::default);
        for (trend, joint) in self.joints.iter_mut().zip(&snapshot.joints) {
            trend.angle.push(joint.q_rad);
            trend.error.push(joint.error_rad);
            trend.current.push(joint.current_a);
        }
        self.events.extend(snapshot.events.iter().cloned());
        let extra = self.events.len().saturating_sub(KEPT);
        self.events.drain(..extra);
    }

    /// The picture: at most as many lines as the terminal has rows, none wider than it.
    pub(super) fn picture(
        &self,
        name: &str,
        snapshot: &Snapshot,
        strangers: &[Stranger],
        view: View,
        hints: Option<&[&str]>,
    ) -> Vec<String> {
        let (width, height) = view.size;
        let foot = usize::from(hints.is_some() && height >= 6);
        let room = height.saturating_sub(foot);
        let mut lines = self.head(name, snapshot, view);
        let table = self.table(snapshot, strangers, width);
        // The table matters more than the space above it, events get what is left.
        if lines.len() + table.len() < room {
            lines.push(Line::default());
        }
        let left = room.saturating_sub(lines.len());
        if table.len() > left && left > 0 {
            let hidden = table.len() - (left - 1);
            lines.extend(table.into_iter().take(left - 1));
            lines.push(
                Line::default().add(Colour::Faint, format!("… {hidden} more lines: make the window higher")),
            );
        } else {
            lines.extend(table);
        }
        let left = room.saturating_sub(lines.len());
        if view.events && left > 2 {
            lines.push(Line::default());
            lines.push(Line::default().add(Colour::Title, "events"));
            let shown = self.events.len().min(left - 2);
            lines.extend(self.events[self.events.len() - shown..].iter().map(event));
        }
        lines.truncate(room);
        if let (Some(hints), 1) = (hints, foot) {
            lines.resize_with(room, Line::default);
            let fits = hints.iter().find(|hint| hint.chars().count() <= width);
            if let Some(hint) = fits.or(hints.last()) {
                lines.push(Line::default().add(Colour::Faint, *hint));
            }
        }
        lines.iter().map(|line| line.text(width, view.colours)).collect()
    }

    fn head(&self, name: &str, snapshot: &Snapshot, view: View) -> Vec<Line> {
        let title = Line::default()
            .add(Colour::Warning, if view.held { "HELD: space goes on  " } else { "" })
            .add(Colour::Title, name)
            .add(Colour::Plain, format!("  {:.1} s", snapshot.t_s))
            .add(
                Colour::Faint,
                if view.held { String::new() } else { format!("  every {} ms", view.period_ms) },
            );
        let errors = match snapshot.bus_errors {
            0 => (Colour::Plain, "no bus errors".to_owned()),
            1 => (Colour::Warning, "1 bus error".to_owned()),
            n => (Colour::Warning, format!("{n} bus errors")),
        };
        let load = snapshot.load_percent;
        let busy = if load > 90.0 { Colour::Bad } else { Colour::Plain };
        let bus = Line::plain("bus load ")
            .add(busy, format!("{load:5.1} % "))
            .add(Colour::Faint, self.load.bars(TREND, 10.0))
            .add(Colour::Plain, "  ")
            .add(errors.0, errors.1)
            .add(Colour::Plain, format!("  {} frames", snapshot.frames));
        let mut lines = vec![title];
        lines.extend(view.stopped.map(|text| Line::default().add(Colour::Bad, text)));
        lines.push(bus);
        match &snapshot.controller {
            Some(controller) => lines.extend(controller_lines(controller)),
            None => lines.push(Line::default().add(Colour::Faint, "no controller is heard")),
        }
        lines
    }

    fn table(&self, snapshot: &Snapshot, strangers: &[Stranger], width: usize) -> Vec<Line> {
        let mut head = format!("{:<8} {:>10}", "joint", "angle rad");
        let mut column = |wanted: usize, text: &str| {
            if width >= wanted {
                head += text;
            }
        };
        column(WITH_TRENDS, &format!(" {:>TREND$}", "trend"));
        column(WITH_SPEED, &format!(" {:>11}", "speed rad/s"));
        column(WITH_ERROR, &format!(" {:>10}", "error mrad"));
        column(WITH_ALL_TRENDS, &format!(" {:>TREND$}", "trend"));
        column(WITH_CURRENT, &format!(" {:>9}", "current A"));
        column(WITH_ALL_TRENDS, &format!(" {:>TREND$}", "trend"));
        let mut lines = vec![Line::default().add(Colour::Title, head + "  state")];
        let none = JointTrend::default();
        for (j, joint) in snapshot.joints.iter().enumerate() {
            lines.push(row(joint, self.joints.get(j).unwrap_or(&none), width));
        }
        for other in strangers {
            let joint = JointView {
                name: format!("drive {}", other.module),
                q_rad: other.position_rad,
                current_a: other.current_a,
                state: other.state.clone(),
                ..JointView::default()
            };
            lines.push(row(&joint, &none, width).add(Colour::Faint, " (not in the robot file)"));
        }
        lines
    }
}

fn number(value: Option<f64>, width: usize, digits: usize) -> String {
    match value.filter(|value| value.is_finite()) {
        // No sign for what rounds to zero.
        Some(value) if value.abs() < 0.5 * 0.1_f64.powi(digits as i32) => format!(" {:>width$.digits$}", 0.0),
        Some(value) => format!(" {value:>+width$.digits$}"),
        None => format!(" {:>width$}", "-"),
    }
}

fn row(joint: &JointView, trend: &JointTrend, width: usize) -> Line {
    let mut line = Line::plain(format!("{:<8}", joint.name)).add(Colour::Plain, number(joint.q_rad, 10, 4));
    let mut column = |wanted: usize, colour: Colour, text: String| {
        if width >= wanted {
            line.pieces.push((colour, text));
        }
    };
    column(WITH_TRENDS, Colour::Faint, format!(" {}", trend.angle.bars(TREND, 0.01)));
    column(WITH_SPEED, Colour::Plain, number(joint.qd_rad_s, 11, 3));
    column(WITH_ERROR, Colour::Plain, number(joint.error_rad.map(|rad| 1e3 * rad), 10, 2));
    column(WITH_ALL_TRENDS, Colour::Faint, format!(" {}", trend.error.bars(TREND, 1e-4)));
    column(WITH_CURRENT, Colour::Plain, number(joint.current_a, 9, 2));
    column(WITH_ALL_TRENDS, Colour::Faint, format!(" {}", trend.current.bars(TREND, 0.1)));
    let (colour, state) = match (joint.age_s, joint.state.as_str()) {
        (None, "") => (Colour::Faint, "not heard".to_owned()),
        (Some(age_s), _) if age_s > SILENT_S => (Colour::Warning, format!("silent for {age_s:.1} s")),
        (_, state) if state.starts_with("error") => (Colour::Bad, state.to_owned()),
        (_, state) if state.contains("not homed") || state.contains("halted") => {
            (Colour::Warning, state.to_owned())
        }
        (_, state) => (Colour::Good, state.to_owned()),
    };
    line.add(Colour::Plain, "  ").add(colour, state)
}

fn controller_lines(controller: &ControllerView) -> Vec<Line> {
    let state = if controller.fault.is_some() || controller.state == "fault" {
        Colour::Bad
    } else if controller.state.starts_with("stop") {
        Colour::Warning
    } else {
        Colour::Good
    };
    let mut first =
        Line::plain(format!("controller {}: ", controller.node_id)).add(state, controller.state.clone());
    if controller.age_s > SILENT_S {
        first = first.add(Colour::Warning, format!("  silent for {:.1} s", controller.age_s));
    }
    let gripper = if controller.gripper_open { "open" } else { "closed" };
    first = first.add(
        Colour::Plain,
        format!(
            "  plan {:.2} s  period {:.1} ms  gripper {gripper}",
            controller.plan_s,
            1e-3 * f64::from(controller.period_us)
        ),
    );
    let counted = |count: u16, one: &str, many: &str| match count {
        0 => (Colour::Plain, format!("no {many}")),
        1 => (Colour::Warning, format!("1 {one}")),
        n => (Colour::Warning, format!("{n} {many}")),
    };
    let mut second = Line::plain("  ");
    for (count, one, many) in [
        (controller.cycles_late, "late cycle", "late cycles"),
        (controller.replies_missed, "missed answer", "missed answers"),
        (controller.cycles_saturated, "clipped acceleration", "clipped accelerations"),
    ] {
        let (colour, text) = counted(count, one, many);
        second = second.add(colour, text).add(Colour::Plain, "  ");
    }
    second = second.add(
        if controller.host_alive { Colour::Plain } else { Colour::Faint },
        if controller.host_alive { "host is heard" } else { "no host is heard" },
    );
    let mut lines = vec![first, second];
    if let Some(fault) = &controller.fault {
        let joint = if fault.joint == 0 { String::new() } else { format!(", joint {}", fault.joint) };
        lines
            .push(Line::default().add(Colour::Bad, format!("  fault {}{joint}: {}", fault.code, fault.what)));
        lines.push(Line::plain(format!("  next: {}", fault.next)));
    }
    lines
}

fn event(event: &EventView) -> Line {
    let colour = match event.severity {
        Severity::Info => Colour::Plain,
        Severity::Warning => Colour::Warning,
        Severity::Error => Colour::Bad,
    };
    Line::default()
        .add(Colour::Faint, format!("{:>8.3} s  ", event.t_s))
        .add(colour, format!("{}: {}", event.source, event.text))
}

#[cfg(test)]
mod tests {
    use super::*;
    use operator::live::LiveState;
    use operator::live::state::FaultView;
    use operator::machine::Machine;
    use protocol::Duration;

    fn snapshot() -> Snapshot {
        let robot = robot_model::AnyRobot::load("powercube6").unwrap();
        let mut snapshot = LiveState::new(Machine::of(&robot), Duration::ZERO, 1_000_000).snapshot(0);
        for (joint, q) in snapshot.joints.iter_mut().zip(1..) {
            joint.q_rad = Some(0.1 * f64::from(q));
            joint.age_s = Some(0.01);
            joint.state = "homed, stands".to_owned();
        }
        snapshot.controller = Some(ControllerView {
            node_id: 10,
            state: "fault".to_owned(),
            age_s: 0.02,
            fault: Some(FaultView { code: 201, joint: 3, what: "no answer".into(), next: "look".into() }),
            plan_s: 0.5,
            period_us: 3_000,
            cycles_late: 2,
            replies_missed: 0,
            cycles_saturated: 0,
            gripper_open: false,
            host_alive: true,
        });
        snapshot.events = (1..20)
            .map(|number| EventView {
                number,
                t_s: 0.1,
                severity: Severity::Warning,
                source: "drive 3".to_owned(),
                text: format!("event {number}"),
            })
            .collect();
        snapshot
    }

    fn view(size: (usize, usize)) -> View {
        View { size, colours: false, held: false, events: true, period_ms: 200, stopped: None }
    }

    fn picture(size: (usize, usize)) -> Vec<String> {
        let (mut screen, snapshot) = (Screen::default(), snapshot());
        screen.take(&snapshot);
        screen.picture("can0", &snapshot, &[], view(size), Some(&["q end   s STOP", "q end"]))
    }

    #[test]
    fn no_picture_is_larger_than_the_terminal() {
        for width in [1, 10, 20, 40, 56, 79, 80, 100, 132, 200] {
            for height in [1, 2, 5, 6, 10, 14, 24, 60] {
                let lines = picture((width, height));
                assert!(lines.len() <= height, "{width} x {height}: {} lines", lines.len());
                for line in &lines {
                    assert!(line.chars().count() <= width, "{width} x {height}: {line:?}");
                }
            }
        }
    }

    #[test]
    fn a_usual_terminal_shows_joints_fault_events_and_keys_in_words() {
        let lines = picture((100, 30));
        let text = lines.join("\n");
        for part in [
            "controller 10: fault",
            "fault 201, joint 3: no answer",
            "next: look",
            "2 late cycles",
            "no missed answers",
            "joint6      +0.6000",
            "homed, stands",
            "event 19",
        ] {
            assert!(text.contains(part), "{part}:\n{text}");
        }
        assert_eq!(lines.last().map(String::as_str), Some("q end   s STOP"));
        assert!(!text.contains('\x1b'), "colours were not wanted");
    }

    #[test]
    fn a_narrow_terminal_keeps_angle_and_state_and_a_low_one_says_what_is_hidden() {
        let text = picture((44, 24)).join("\n");
        assert!(text.contains("joint1      +0.1000  homed, stands") && !text.contains("current"), "{text}");
        assert_eq!(picture((10, 24)).last().map(String::as_str), Some("q end"), "the hint that fits");
        assert_eq!(picture((4, 24)).last().map(String::as_str), Some("q e…"));
        let text = picture((80, 9)).join("\n");
        assert!(text.contains("more lines: make the window higher"), "{text}");
    }

    #[test]
    fn a_held_picture_and_a_stop_are_told_and_so_is_the_period() {
        let (mut screen, snapshot) = (Screen::default(), snapshot());
        screen.take(&snapshot);
        let first = |view| screen.picture("can0", &snapshot, &[], view, None)[..2].join("\n");
        let usual = view((100, 30));
        assert!(first(usual).contains("every 200 ms") && !first(usual).contains("HELD"), "{}", first(usual));
        assert!(first(View { held: true, ..usual }).contains("HELD: space goes on"));
        assert!(first(View { stopped: Some("stopped"), ..usual }).contains("\nstopped"));
    }

    #[test]
    fn trends_span_from_the_smallest_to_the_largest_value_and_leave_gaps() {
        let mut series = Series::default();
        for value in [Some(0.0), None, Some(0.5), Some(1.0)] {
            series.push(value);
        }
        assert_eq!(series.bars(5, 0.1), " ▁ ▅█");
        assert_eq!(series.bars(2, 0.1), "▁█");
        let mut still = Series::default();
        (0..3).for_each(|_| still.push(Some(2.0)));
        assert_eq!(still.bars(3, 0.1), "▁▁▁", "noise below the span is no trend");
    }

    #[test]
    fn colours_mark_words_and_add_no_width() {
        let line = Line::default().add(Colour::Bad, "error").add(Colour::Plain, " x");
        assert_eq!(line.text(4, true), "\x1b[1;31merr…\x1b[0m");
        assert_eq!(line.text(80, false), "error x");
        assert_eq!((line.text(6, false).as_str(), line.text(7, false).as_str()), ("error…", "error x"));
    }
}
