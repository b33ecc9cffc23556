//! Advice that depends on the kind of the bus: where its bit rate is set, and how it starts again after bus-off.

use can_link::BusSpec;
use operator::bus::Session;
use protocol::text::slcan::Bitrate;

/// What to do in a cell that is simulated.
const SIMULATED: &str = "look at the scenario: `cubectl explain faults` lists what it can do";
/// Rate that is tried next, and the others that modules know, bit/s.
const OTHER_RATES: &str = "or 250000, 1000000";

/// The bus of a session; `None` for the cell inside this program. The name of any other bus is its specification.
fn spec_of(session: &Session) -> Option<BusSpec> {
    if session.is_simulated() {
        return None;
    }
    session.name().parse().ok()
}

/// What to do if no module answers and the wire is quiet.
pub(super) fn no_answer(session: &Session) -> String {
    rate_and_restart(spec_of(session).as_ref()).0
}

/// What to do after bus-off.
pub(super) fn after_bus_off(session: &Session) -> String {
    rate_and_restart(spec_of(session).as_ref()).1
}

/// Advice for a quiet wire, and for bus-off.
fn rate_and_restart(bus: Option<&BusSpec>) -> (String, String) {
    let (rate, restart) = match bus {
        Some(BusSpec::SocketCan { interface }) => (
            format!(
                "`sudo ip link set {interface} down`, then `sudo ip link set {interface} up type can bitrate 500000` \
                 ({OTHER_RATES})"
            ),
            format!("`sudo ip link set {interface} down && sudo ip link set {interface} up`"),
        ),
        Some(BusSpec::Slcan { port, .. }) => {
            let other = BusSpec::Slcan { port: port.clone(), bitrate: Bitrate::K500 };
            (format!("--bus '{other}' ({OTHER_RATES})"), "unplug the adapter and plug it in again".to_owned())
        }
        other => match other.and_then(BusSpec::server) {
            Some(host) => (
                format!("it is set where the server of this bus runs, on {host}"),
                format!("restart the interface on {host}"),
            ),
            None => return (SIMULATED.to_owned(), SIMULATED.to_owned()),
        },
    };
    (
        format!("check the supply of the modules and the bit rate: {rate}"),
        format!("wrong bit rate, or CAN-H and CAN-L short or swapped; then {restart}"),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn advice_names_what_sets_the_bit_rate_of_each_kind_of_bus() {
        for (bus, silence, bus_off) in [
            (
                "can1",
                "`sudo ip link set can1 up type can bitrate 500000`",
                "set can1 down && sudo ip link set can1 up",
            ),
            ("slcan:/dev/ttyACM0", "--bus 'slcan:/dev/ttyACM0?bitrate=500000'", "plug it in again"),
            ("slcan://lab:3333", "--bus 'slcan://lab:3333?bitrate=500000'", "plug it in again"),
            ("socketcand://lab:29536/can0", "the server of this bus runs, on lab", "the interface on lab"),
        ] {
            let spec: BusSpec = bus.parse().unwrap();
            let next = <[String; 2]>::from(rate_and_restart(Some(&spec)));
            assert!(next[0].contains(silence) && next[1].contains(bus_off), "{next:?}");
        }
        assert!(<[String; 2]>::from(rate_and_restart(None)).iter().all(|next| next.contains("scenario")));
    }
}
