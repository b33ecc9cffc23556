//! The station behind a UDP socket, in real time.

use std::io::ErrorKind;
use std::net::{SocketAddr, UdpSocket};
use std::time::Instant as WallTime;

use protocol::{Duration, Instant};

use super::station::Station;

/// Longest datagram that is read, bytes; longer ones are cut and then unreadable.
const LONGEST: usize = rsi_protocol::MAX_READ_BYTES;
/// Longest wait without a look at `goes_on`.
const LOOK: std::time::Duration = std::time::Duration::from_millis(20);
/// Telegrams that are drained in one go; more waiting ones are drained in the next.
const DRAINED: usize = 64;
/// After the end of the throw telegrams are answered for so long: the arm holds until then.
const AFTER: Duration = Duration::from_millis(500);

/// How the exchange went.
#[derive(Clone, Debug, Default)]
pub struct Exchange {
    /// From the arrival of a telegram to its answer, us, one per answer.
    pub answer_us: Vec<u32>,
    /// Robots (sockets) that were heard.
    pub connections: u32,
}

/// Serves until the throw has ended, or `goes_on` says no; then the arm is stopped first.
///
/// # Errors
/// The socket fails.
pub fn serve(
    socket: &UdpSocket,
    station: &mut Station,
    goes_on: &dyn Fn() -> bool,
) -> std::io::Result<Exchange> {
    let begun = WallTime::now();
    let now = || Instant::from_micros(u64::try_from(begun.elapsed().as_micros()).unwrap_or(u64::MAX));
    let mut exchange = Exchange::default();
    let mut robot: Option<SocketAddr> = None;
    let mut ends_at: Option<Instant> = None;
    let mut stopping = false;
    let mut buffer = vec![0; LONGEST];
    loop {
        if !goes_on() && !stopping {
            stopping = true;
            station.stop(now());
            ends_at = ends_at.or(Some(now() + Duration::from_secs(3)));
        }
        if station.stage().is_end() {
            ends_at = Some(ends_at.map_or(now() + AFTER, |at| at.min(now() + AFTER)));
        }
        if ends_at.is_some_and(|at| at <= now()) {
            return Ok(exchange);
        }
        let left = station.poll_timeout().map_or(LOOK, |due| {
            std::time::Duration::from_micros(due.saturating_since(now()).as_micros()).min(LOOK)
        });
        if left.is_zero() {
            station.handle_timeout(now());
            continue;
        }
        socket.set_read_timeout(Some(left))?;
        let Some((first, from)) = receive(socket, &mut buffer)? else { continue };
        let arrived = WallTime::now();
        let (mut waiting, mut newest_from) = (vec![first], from);
        socket.set_nonblocking(true)?;
        while waiting.len() < DRAINED
            && let Some((bytes, from)) = receive(socket, &mut buffer)?
        {
            if from != newest_from {
                // Another robot, or its new run: what the one before sent is void.
                waiting.clear();
            }
            newest_from = from;
            waiting.push(bytes);
        }
        socket.set_nonblocking(false)?;
        let new_connection = robot.is_some_and(|robot| robot != newest_from);
        exchange.connections += u32::from(robot != Some(newest_from));
        robot = Some(newest_from);
        if let Some(answer) = station.handle(now(), &waiting, new_connection) {
            socket.send_to(&answer, newest_from)?;
            let took = arrived.elapsed().as_micros();
            exchange.answer_us.push(u32::try_from(took).unwrap_or(u32::MAX));
        }
    }
}

/// A datagram, if one is there in time. An unreachable peer, told by its host, is a robot that has ended.
fn receive(socket: &UdpSocket, buffer: &mut [u8]) -> std::io::Result<Option<(Vec<u8>, SocketAddr)>> {
    match socket.recv_from(buffer) {
        Ok((length, from)) => Ok(Some((buffer[..length].to_vec(), from))),
        Err(error) => match error.kind() {
            ErrorKind::WouldBlock
            | ErrorKind::TimedOut
            | ErrorKind::Interrupted
            | ErrorKind::ConnectionRefused
            | ErrorKind::ConnectionReset => Ok(None),
            _ => Err(error),
        },
    }
}
