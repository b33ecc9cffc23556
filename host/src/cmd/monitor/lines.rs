//! `cubectl monitor --plain`: a line per module, joint and controller, in fields that other programs read.

use std::fmt::Write as _;

use firmware::fault::Cause;
use protocol::powercube::CubeState;
use protocol::{Duration, Instant};

use crate::cmd::fixed;
use crate::cmd::report::BIT_RATE;
use operator::bus::Session;
use operator::node::host_node::{HostNode, Tally, utilisation};
use operator::node::inbox::Said;

/// What was heard in `span` since `before`.
pub(super) fn lines(session: &mut Session, before: Tally, span: Duration) -> String {
    let (now, errors) = (session.now(), session.bus_errors().len());
    let group = controller(session.host_node());
    let said = said(session);
    let host_node = session.host_node();
    let mut tally = host_node.tally();
    tally.bits -= before.bits;
    let load = 100.0 * utilisation(tally, span, BIT_RATE);
    let mut text = String::new();
    if !group.is_empty() {
        let _ = write!(text, "t_s={:.3} {group}", now.as_secs_f64());
    }
    for (module, heard) in host_node.heard() {
        let number = |value: Option<f32>, digits| value.map_or("-".to_owned(), |v| fixed(v.into(), digits));
        let age_ms = now.saturating_since(heard.at).as_micros() / 1_000;
        let (position, current) = (number(heard.position_rad, 4), number(heard.current_a, 2));
        let state = heard.state.map_or("?".to_owned(), |state: CubeState| state.to_string());
        let _ = writeln!(
            text,
            "t_s={:.3} module={module} position_rad={position} current_a={current} age_ms={age_ms} state={state} \
             load_percent={load:.1} bus_errors={errors}",
            now.as_secs_f64()
        );
    }
    text + &said
}

/// What controllers said since the last picture, a line each.
fn said(session: &mut Session) -> String {
    let line = |(at, said): (Instant, Said)| {
        format!(
            "t_s={:.3} controller={} severity={:?} says=\"{}\"\n",
            at.as_secs_f64(),
            said.from.get(),
            said.severity,
            said.text
        )
    };
    session.take_said().into_iter().map(line).collect()
}

/// What a controller told last: the group, then its joints; empty if none is heard.
fn controller(host_node: &mut HostNode) -> String {
    let Some(inbox) = host_node.inbox() else { return String::new() };
    let Some((_, node, group)) = inbox.group else { return String::new() };
    let cause = Cause::from_code(group.fault_cause).map_or("none", Cause::name);
    let mut text = String::new();
    let _ = writeln!(
        text,
        "controller={} state={:?} fault={cause} fault_joint={} plan_s={:.3} period_us={} jitter_us={} late={} \
         missed={} saturated={} load_percent={:.1} host={}",
        node.get(),
        group.state,
        group.fault_joint,
        f64::from(group.trajectory_time_us) * 1e-6,
        group.cycle_us,
        group.cycle_jitter_us,
        group.cycles_late,
        group.replies_missed,
        group.cycles_saturated,
        f64::from(group.bus_load_permille) / 10.0,
        if group.host_alive { "alive" } else { "silent" },
    );
    let Some((_, source, state)) = &inbox.joints else { return text };
    for (index, joint) in state.joints().iter().enumerate() {
        let number = index + 1;
        let _ = writeln!(
            text,
            "controller={} joint={number} q_rad={} qd_rad_s={} error_mrad={} current_a={}",
            source.get(),
            fixed(joint.q_rad.into(), 4),
            fixed(joint.qd_rad_s.into(), 4),
            fixed(1e3 * f64::from(joint.error_q_rad), 2),
            fixed(joint.current_a.into(), 2)
        );
    }
    text
}
