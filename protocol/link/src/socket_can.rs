//! Linux SocketCAN: a real interface, or `vcan`.

use std::collections::VecDeque;
use std::fs;
use std::io::{self, ErrorKind};
use std::os::fd::AsFd;
use std::time::SystemTime;

use protocol::{Duration, FdFlags, Frame, Instant};
use rustix::io::Errno;
use socketcan::{
    CanAnyFrame, CanErrorFrame, CanFdFrame, CanFdSocket, CanFrame, EmbeddedFrame, Socket, SocketOptions,
};

use crate::bus_error::BusError;
use crate::clock::Clock;
use crate::error::{LinkError, OpenError, SendError};
use crate::link::{CanLink, LinkEvent, LinkStats, PollSet};

/// Frames that wait while the interface's own queue (10 frames by default) is full.
const OUTPUT_QUEUE: usize = 1024;

/// Time after which sending is tried again: the kernel does not report when the interface's queue has room.
const RETRY: Duration = Duration::from_micros(200);

/// `type` of a CAN interface under `/sys/class/net` (`ARPHRD_CAN` of Linux `if_arp.h`).
const ARPHRD_CAN: u32 = 280;

/// MTU of an interface that takes CAN FD frames (`CANFD_MTU` of Linux `can.h`); a classical one has 16.
const CANFD_MTU: u32 = 72;

/// Bit of the interface flags under `/sys/class/net` (`IFF_UP` of Linux `if.h`).
const IFF_UP: u32 = 1;

/// A SocketCAN interface.
///
/// Own frames are not received back; other programs of this machine see them. Received frames carry the kernel's
/// time stamp. While the interface accepts no frames (no node acknowledges, bus-off), 1 024 wait here and further
/// ones are refused ([`SendError::QueueFull`]). CAN FD frames are sent if the interface takes them by its MTU, else refused
/// ([`LinkError::ClassicalOnly`]); those that come are received, long or short.
pub struct SocketCan {
    name: String,
    clock: Clock,
    socket: CanFdSocket,
    takes_fd: bool,
    queue: VecDeque<CanAnyFrame>,
    retry_at: Option<Instant>,
    /// Latest arrival handed out, so that arrivals never decrease.
    last: Instant,
    failure: Option<LinkError>,
    stats: LinkStats,
}

impl SocketCan {
    /// Joins the bus at `interface`, which must be up.
    ///
    /// # Errors
    ///
    /// There is no such interface, it is down or not a CAN interface, the kernel has no CAN, or the right to open
    /// it is missing; each error has the command that helps.
    pub fn open(interface: &str, clock: Clock) -> Result<Self, OpenError> {
        check(interface)?;
        let socket = Self::set_up(interface).map_err(|source| explain(interface, source))?;
        Ok(Self {
            name: interface.to_owned(),
            clock,
            socket,
            // Without /sys the kernel refuses what does not fit.
            takes_fd: attribute(interface, "mtu").ok().and_then(|mtu| mtu.trim().parse().ok())
                >= Some(CANFD_MTU),
            queue: VecDeque::new(),
            retry_at: None,
            last: Instant::ZERO,
            failure: None,
            stats: LinkStats::default(),
        })
    }

    fn set_up(interface: &str) -> io::Result<CanFdSocket> {
        let socket = CanFdSocket::open(interface)?;
        socket.set_nonblocking(true)?;
        socket.set_loopback(true)?;
        socket.set_recv_own_msgs(false)?;
        socket.set_error_filter_accept_all()?;
        socket.set_recv_timestamp(true)?;
        Ok(socket)
    }

    fn fail(&mut self, error: &io::Error) -> LinkError {
        let error = if error.raw_os_error() == Some(Errno::NETDOWN.raw_os_error()) {
            LinkError::InterfaceDown { link: self.name.clone(), command: up_command(&self.name) }
        } else {
            LinkError::io(&self.name, error)
        };
        self.failure.get_or_insert(error).clone()
    }

    /// Sends what waits, in order, until the interface is full.
    fn flush(&mut self) -> Result<(), LinkError> {
        self.retry_at = None;
        while let Some(frame) = self.queue.front() {
            match self.socket.write_frame(frame) {
                Ok(()) => {
                    self.queue.pop_front();
                }
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(error)
                    if error.kind() == ErrorKind::WouldBlock
                        || error.raw_os_error() == Some(Errno::NOBUFS.raw_os_error()) =>
                {
                    self.retry_at = Some(self.clock.now() + RETRY);
                    return Ok(());
                }
                Err(error) => return Err(self.fail(&error)),
            }
        }
        Ok(())
    }

    fn event(&mut self, frame: &CanAnyFrame, stamp: SystemTime) -> Option<LinkEvent> {
        let now = self.clock.now();
        let unix = self.clock.unix_of(stamp);
        // The kernel's stamp is by the system's clock; the converted time is kept between the last event and now.
        self.last = self.clock.from_unix(unix).min(now).max(self.last);
        let at = self.last;
        let frame = match frame {
            CanAnyFrame::Normal(frame) => Frame::from_embedded_can(frame),
            CanAnyFrame::Remote(frame) => Frame::from_embedded_can(frame),
            CanAnyFrame::Fd(frame) => {
                let flags = FdFlags { brs: frame.is_brs(), esi: frame.is_esi() };
                Frame::new_fd(frame.id(), flags, frame.data())
            }
            CanAnyFrame::Error(frame) => return Some(LinkEvent::BusError { at, error: bus_error(frame) }),
        };
        match frame {
            Ok(frame) => {
                self.stats.frames_in += 1;
                Some(LinkEvent::Frame { at, stamp: Some(unix), frame })
            }
            Err(_) => {
                self.stats.malformed_in += 1;
                None
            }
        }
    }
}

impl CanLink for SocketCan {
    fn name(&self) -> &str {
        &self.name
    }

    fn send(&mut self, frame: &Frame) -> Result<(), SendError> {
        if let Some(error) = &self.failure {
            return Err(error.clone().into());
        }
        if frame.fd().is_some() {
            self.takes_fd()?;
        }
        // The driver's types hold each frame.
        let Some(can_frame) = to_linux(frame).filter(|_| self.queue.len() < OUTPUT_QUEUE) else {
            self.stats.dropped_out += 1;
            return Err(SendError::QueueFull { link: self.name.clone() });
        };
        self.queue.push_back(can_frame);
        self.stats.frames_out += 1;
        Ok(self.flush()?)
    }

    fn receive(&mut self) -> Result<Option<LinkEvent>, LinkError> {
        if let Some(error) = &self.failure {
            return Err(error.clone());
        }
        self.flush()?;
        loop {
            match self.socket.read_frame_with_timestamp() {
                Ok((frame, stamp)) => {
                    if let Some(event) = self.event(&frame, stamp) {
                        return Ok(Some(event));
                    }
                }
                Err(error) if error.kind() == ErrorKind::WouldBlock => return Ok(None),
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(error) => return Err(self.fail(&error)),
            }
        }
    }

    fn takes_fd(&self) -> Result<(), LinkError> {
        let error = || LinkError::ClassicalOnly { link: self.name.clone(), advice: fd_command(&self.name) };
        if self.takes_fd { Ok(()) } else { Err(error()) }
    }

    fn register<'a>(&'a self, set: &mut PollSet<'a>) {
        set.add_borrowed(self.socket.as_fd(), true, false);
    }

    fn deadline(&self) -> Option<Instant> {
        self.retry_at
    }

    fn stats(&self) -> LinkStats {
        self.stats
    }
}

fn to_linux(frame: &Frame) -> Option<CanAnyFrame> {
    let Some(flags) = frame.fd() else { return frame.to_embedded_can::<CanFrame>().map(CanAnyFrame::from) };
    let mut long = CanFdFrame::new(frame.id(), frame.data())?;
    long.set_brs(flags.brs);
    long.set_esi(flags.esi);
    Some(long.into())
}

fn bus_error(frame: &CanErrorFrame) -> BusError {
    let mut details = [0; 8];
    for (to, from) in details.iter_mut().zip(frame.data()) {
        *to = *from;
    }
    BusError { class: frame.error_bits(), details }
}

/// What the kernel says about the interface.
fn attribute(interface: &str, name: &str) -> io::Result<String> {
    fs::read_to_string(format!("/sys/class/net/{interface}/{name}"))
}

/// Reads the kernel's data about the interface before it is opened: errno alone says less.
fn check(interface: &str) -> Result<(), OpenError> {
    let kind = match attribute(interface, "type") {
        Ok(kind) => kind,
        Err(error) if error.kind() == ErrorKind::NotFound => return Err(no_interface(interface)),
        // Without /sys only errno is known.
        Err(_) => return Ok(()),
    };
    if kind.trim().parse() != Ok(ARPHRD_CAN) {
        return Err(OpenError::NotCan { interface: interface.to_owned(), present: can_interfaces() });
    }
    let flags = attribute(interface, "flags").unwrap_or_default();
    let flags = u32::from_str_radix(flags.trim().trim_start_matches("0x"), 16).unwrap_or(IFF_UP);
    if flags & IFF_UP == 0 {
        let command = up_command(interface);
        return Err(OpenError::InterfaceDown { interface: interface.to_owned(), command });
    }
    Ok(())
}

fn explain(interface: &str, source: io::Error) -> OpenError {
    let interface = interface.to_owned();
    match source.raw_os_error().map(Errno::from_raw_os_error) {
        Some(Errno::NODEV) => no_interface(&interface),
        Some(Errno::AFNOSUPPORT | Errno::PROTONOSUPPORT) => OpenError::NoCanInKernel { interface },
        Some(Errno::PERM | Errno::ACCESS) => OpenError::NoPermission { interface, source },
        _ => OpenError::Setup { what: "SocketCAN", address: interface, source },
    }
}

fn no_interface(interface: &str) -> OpenError {
    let present = can_interfaces();
    let command = if interface.starts_with("vcan") {
        format!(
            "sudo modprobe vcan && sudo ip link add {interface} type vcan && sudo ip link set {interface} up"
        )
    } else if interface.starts_with("slcan") {
        format!("sudo slcand -o -s8 /dev/ttyACM0 {interface} && sudo ip link set {interface} up")
    } else {
        "plug the adapter in and load its driver; `ip -details link show type can` lists interfaces"
            .to_owned()
    };
    OpenError::NoInterface { interface: interface.to_owned(), present, command }
}

fn up_command(interface: &str) -> String {
    if interface.starts_with("vcan") || interface.starts_with("slcan") {
        format!("sudo ip link set {interface} up")
    } else {
        format!("sudo ip link set {interface} up type can bitrate 1000000")
    }
}

/// What makes the interface take CAN FD frames.
fn fd_command(interface: &str) -> String {
    let up = if interface.starts_with("vcan") {
        format!("mtu {CANFD_MTU} up")
    } else {
        "up type can bitrate 1000000 dbitrate 5000000 fd on".to_owned()
    };
    format!("`sudo ip link set {interface} down`, then `sudo ip link set {interface} {up}`")
}

/// Names of the CAN interfaces of this machine, for people.
fn can_interfaces() -> String {
    let Ok(entries) = fs::read_dir("/sys/class/net") else { return "unknown".to_owned() };
    let mut names: Vec<String> = entries
        .flatten()
        .filter(|entry| {
            let kind = fs::read_to_string(entry.path().join("type")).unwrap_or_default();
            kind.trim().parse() == Ok(ARPHRD_CAN)
        })
        .filter_map(|entry| entry.file_name().into_string().ok())
        .collect();
    names.sort();
    if names.is_empty() { "none".to_owned() } else { names.join(", ") }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_missing_interface_is_explained_with_the_command_that_makes_it() {
        let error = SocketCan::open("vcan93", Clock::start()).map(|_| ()).unwrap_err();
        let OpenError::NoInterface { command, .. } = &error else { panic!("{error}") };
        assert!(command.contains("ip link add vcan93 type vcan"), "{error}");
        let error = SocketCan::open("can93", Clock::start()).map(|_| ()).unwrap_err();
        assert!(error.to_string().contains("no interface 'can93'"), "{error}");
    }

    #[test]
    fn an_interface_of_another_kind_is_refused_by_name() {
        let error = SocketCan::open("lo", Clock::start()).map(|_| ()).unwrap_err();
        assert!(matches!(error, OpenError::NotCan { .. }), "{error}");
        assert!(error.to_string().contains("'lo' is not a CAN interface"), "{error}");
    }

    #[test]
    fn the_answers_of_the_kernel_are_distinguished() {
        let error = |errno: Errno| explain("can0", errno.into());
        assert!(matches!(error(Errno::AFNOSUPPORT), OpenError::NoCanInKernel { .. }));
        assert!(matches!(error(Errno::PERM), OpenError::NoPermission { .. }));
        assert!(matches!(error(Errno::NODEV), OpenError::NoInterface { .. }));
        assert!(matches!(error(Errno::NOMEM), OpenError::Setup { .. }));
        assert_eq!(up_command("can0"), "sudo ip link set can0 up type can bitrate 1000000");
        assert_eq!(up_command("vcan0"), "sudo ip link set vcan0 up");
        assert!(fd_command("can0").ends_with("up type can bitrate 1000000 dbitrate 5000000 fd on`"));
        assert!(fd_command("vcan0").ends_with("`sudo ip link set vcan0 mtu 72 up`"));
    }

    #[test]
    fn frames_become_those_of_linux_with_their_size_and_flags() {
        use socketcan::frame::AsPtr;
        let id = protocol::StandardId::new(1).unwrap();
        let classical = Frame::from_array(id, [0xFF; 8]);
        let long = Frame::new_fd(id, FdFlags { brs: true, esi: true }, &[0xA5; 64]).unwrap();
        for (frame, size, flags) in
            [(classical, 16, 0), (classical.with_fd(FdFlags::BRS), 72, 5), (long, 72, 7)]
        {
            let linux = to_linux(&frame).unwrap();
            assert_eq!(linux.size(), size, "{frame}");
            let CanAnyFrame::Fd(linux) = linux else { continue };
            assert_eq!((linux.flags().bits(), linux.data()), (flags, frame.data()), "1 BRS, 2 ESI, 4 FDF");
        }
    }

    #[test]
    fn error_frames_keep_class_and_details() {
        let frame = CanErrorFrame::new_error(0x44, &[0, 0x20, 0, 0, 0, 0, 7, 9]).unwrap();
        let error = bus_error(&frame);
        assert_eq!((error.class, error.details), (0x44, [0, 0x20, 0, 0, 0, 0, 7, 9]));
    }
}
