//! Serial devices and pseudo-terminals as byte streams.

use std::fs::{File, OpenOptions};
use std::io;
use std::os::fd::OwnedFd;
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};

use rustix::fs::{FlockOperation, OFlags, fcntl_getfl, fcntl_setfl, flock};
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use rustix::termios::{ControlModes, OptionalActions, QueueSelector, isatty, tcflush, tcgetattr, tcsetattr};

use crate::error::OpenError;
use crate::stream::{Medium, Stream};

/// Opens a serial device for binary data; `baud` in bit/s, `None` leaves the speed as it is.
pub(crate) fn open_device(path: &Path, baud: Option<u32>) -> Result<Stream, OpenError> {
    let error = |source| OpenError::Device { path: path.to_owned(), source };
    let flags = (OFlags::NONBLOCK | OFlags::NOCTTY).bits();
    let file = OpenOptions::new()
        .read(true)
        .write(true)
        .custom_flags(flags.cast_signed())
        .open(path)
        .map_err(error)?;
    if !isatty(&file) {
        return Err(OpenError::NotSerial { path: path.to_owned() });
    }
    // Two programs that read the same adapter each get half of the lines. Other serial libraries use the same lock;
    // `TIOCEXCL` would outlive the program on a pseudo-terminal.
    flock(&file, FlockOperation::NonBlockingLockExclusive)
        .map_err(|_| error(io::ErrorKind::ResourceBusy.into()))?;
    set_raw(&file, baud).map_err(error)?;
    Ok(Stream::new(Medium::Serial { file, _far_end: None }))
}

/// A new pseudo-terminal: the near end as a stream, and the path of the far end.
pub(crate) fn open_pty() -> io::Result<(Stream, PathBuf)> {
    let near = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC)?;
    grantpt(&near)?;
    unlockpt(&near)?;
    let path = ptsname(&near, Vec::new())?;
    let path = PathBuf::from(path.into_string().map_err(|_| io::ErrorKind::InvalidData)?);
    let far: OwnedFd = OpenOptions::new()
        .read(true)
        .write(true)
        .custom_flags(OFlags::NOCTTY.bits().cast_signed())
        .open(&path)?
        .into();
    // The settings belong to the pair: a program that opens the far end finds it raw.
    let far_file = File::from(far);
    set_raw(&far_file, None)?;
    fcntl_setfl(&near, fcntl_getfl(&near)? | OFlags::NONBLOCK)?;
    let medium = Medium::Serial { file: File::from(near), _far_end: Some(far_file.into()) };
    Ok((Stream::new(medium), path))
}

fn set_raw(file: &File, baud: Option<u32>) -> io::Result<()> {
    let mut settings = tcgetattr(file)?;
    settings.make_raw();
    // No modem lines, no hardware flow control: adapters have neither.
    settings.control_modes |= ControlModes::CLOCAL | ControlModes::CREAD;
    settings.control_modes -= ControlModes::CRTSCTS;
    if let Some(baud) = baud {
        settings.set_speed(baud)?;
    }
    tcsetattr(file, OptionalActions::Now, &settings)?;
    // What arrived before the settings is not ours.
    tcflush(file, QueueSelector::IOFlush)?;
    Ok(())
}
