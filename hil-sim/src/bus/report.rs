//! Figures of a bus as a table for people and as data for machines.

use std::borrow::Cow;
use std::fmt;

use serde::Serialize;

use super::counters::Confinement;
use super::medium::Bus;
use super::stats::ErrorCounts;

/// Snapshot of a bus. Times in microseconds, `of_time` a share of the elapsed time.
#[derive(Clone, Debug, Serialize)]
pub struct BusReport {
    /// Bits per second.
    pub bit_rate_bit_s: u32,
    /// Of the data phase of CAN FD frames; absent on a classical bus.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub data_bit_rate_bit_s: Option<u32>,
    /// Time covered, seconds.
    pub elapsed_s: f64,
    /// Share of time taken by frames (with intermission) and error frames, 0 to 1.
    pub utilisation: f64,
    /// Share of time lost to errors, 0 to 1.
    pub error_share: f64,
    /// Rows by bus priority.
    pub ids: Vec<IdRow>,
    pub nodes: Vec<NodeRow>,
}

/// Figures of one identifier.
#[derive(Clone, Debug, Serialize)]
pub struct IdRow {
    /// As in candump: three or eight hexadecimal digits.
    pub id: String,
    pub frames: u64,
    /// Share of the elapsed time.
    pub utilisation: f64,
    /// Mean time from queueing to start, microseconds.
    pub wait_mean_us: f64,
    /// Worst time from queueing to start, microseconds.
    pub wait_max_us: f64,
    /// Worst time from queueing to end of frame, microseconds.
    pub response_max_us: f64,
    pub arbitrations_lost: u64,
    /// Attempts repeated because of an error.
    pub retransmissions: u64,
    /// Error flags while this id was on the bus.
    pub errors: ErrorCounts,
}

#[derive(Clone, Debug, Serialize)]
pub struct NodeRow {
    /// What people call it.
    pub name: String,
    /// Fault confinement state at the end.
    pub state: Confinement,
    /// Transmit error counter at the end.
    pub tec: u16,
    /// Receive error counter at the end.
    pub rec: u16,
    pub tec_peak: u16,
    pub rec_peak: u16,
    pub sent: u64,
    pub received: u64,
    /// Frames that found the transmit queue full.
    pub dropped: u64,
    /// Frames lost with the power.
    pub flushed: u64,
    /// Most frames waiting at once.
    pub queue_peak: usize,
    /// Attempts repeated because of an error.
    pub retransmissions: u64,
    pub arbitrations_lost: u64,
    /// Error flags it began.
    pub errors: ErrorCounts,
    /// Times it became error-passive.
    pub became_passive: u64,
    /// Times it went bus-off.
    pub became_bus_off: u64,
}

impl BusReport {
    /// Takes the figures of `bus`; `name` gives what people call a port.
    pub fn new<'a>(bus: &Bus, mut name: impl FnMut(usize) -> Cow<'a, str>) -> Self {
        let elapsed_ns = bus.now_ns();
        let share = |ns: u64| if elapsed_ns == 0 { 0.0 } else { ns as f64 / elapsed_ns as f64 };
        let us = |ns: u64| ns as f64 / 1e3;
        let ids = bus
            .ids()
            .sorted()
            .iter()
            .map(|row| IdRow {
                id: row.id.to_string(),
                frames: row.frames,
                utilisation: share(row.busy_ns),
                wait_mean_us: row.wait_mean_ns() / 1e3,
                wait_max_us: us(row.wait_max_ns),
                response_max_us: us(row.response_max_ns),
                arbitrations_lost: row.arbitrations_lost,
                retransmissions: row.failed_attempts,
                errors: row.errors,
            })
            .collect();
        let nodes = (0..bus.ports())
            .map(|port| {
                let ((tec, rec), (tec_peak, rec_peak)) =
                    (bus.error_counters(port), bus.error_counter_peaks(port));
                let stats = bus.port_stats(port);
                NodeRow {
                    name: name(port).into_owned(),
                    state: bus.confinement(port),
                    tec,
                    rec,
                    tec_peak,
                    rec_peak,
                    sent: stats.sent,
                    received: stats.received,
                    dropped: bus.queue(port).dropped(),
                    flushed: stats.flushed,
                    queue_peak: bus.queue(port).peak(),
                    retransmissions: stats.failed_attempts,
                    arbitrations_lost: stats.arbitrations_lost,
                    errors: stats.errors,
                    became_passive: stats.became_passive,
                    became_bus_off: stats.became_bus_off,
                }
            })
            .collect();
        Self {
            bit_rate_bit_s: bus.bit_rate_bit_s(),
            data_bit_rate_bit_s: bus.data_bit_rate_bit_s(),
            elapsed_s: elapsed_ns as f64 * 1e-9,
            utilisation: share(bus.busy_ns()),
            error_share: share(bus.error_ns()),
            ids,
            nodes,
        }
    }
}

impl fmt::Display for BusReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let data_rate = self.data_bit_rate_bit_s;
        let data_rate = data_rate.map_or(String::new(), |rate| format!(" and {}", f64::from(rate) / 1e3));
        writeln!(
            f,
            "bus: {}{data_rate} kbit/s, {:.3} s, utilisation {:.1} %, of which errors {:.2} %",
            f64::from(self.bit_rate_bit_s) / 1e3,
            self.elapsed_s,
            self.utilisation * 100.0,
            self.error_share * 100.0
        )?;
        writeln!(
            f,
            "{:>8} {:>9} {:>6} {:>10} {:>10} {:>10} {:>8} {:>7} {:>7}",
            "id", "frames", "use %", "wait us", "worst us", "resp. us", "lost arb", "resent", "errors"
        )?;
        for row in &self.ids {
            writeln!(
                f,
                "{:>8} {:>9} {:>6.2} {:>10.1} {:>10.1} {:>10.1} {:>8} {:>7} {:>7}",
                row.id,
                row.frames,
                row.utilisation * 100.0,
                row.wait_mean_us,
                row.wait_max_us,
                row.response_max_us,
                row.arbitrations_lost,
                row.retransmissions,
                row.errors.total()
            )?;
        }
        writeln!(
            f,
            "{:>24} {:>8} {:>9} {:>9} {:>8} {:>8} {:>7} {:>7} {:>7} {:>7}",
            "node",
            "state",
            "sent",
            "received",
            "dropped",
            "resent",
            "errors",
            "TEC max",
            "REC max",
            "bus-off"
        )?;
        for row in &self.nodes {
            let state = match row.state {
                Confinement::Active => "active",
                Confinement::Passive => "passive",
                Confinement::BusOff => "bus-off",
            };
            writeln!(
                f,
                "{:>24} {:>8} {:>9} {:>9} {:>8} {:>8} {:>7} {:>7} {:>7} {:>7}",
                row.name,
                state,
                row.sent,
                row.received,
                row.dropped + row.flushed,
                row.retransmissions,
                row.errors.total(),
                row.tec_peak,
                row.rec_peak,
                row.became_bus_off
            )?;
        }
        Ok(())
    }
}
