//! The socketcand protocol: CAN over TCP as messages in angle brackets.
//!
//! A server greets with `< hi >`; the client answers `< open can0 >`, then `< rawmode >`, each
//! acknowledged with `< ok >`. From then on every frame of the bus comes as
//! `< frame 0A5 23.424242 084F64 >` and the client sends with `< send 0A5 3 8 4f 64 >`.
//!
//! | file | what |
//! |---|---|
//! | [`Command`] | client to server |
//! | [`Message`] | server to client |
//! | [`Assembler`] | bytes of the stream to whole messages |
//!
//! Differences between the description of the protocol and the programs are accepted in both forms, and written in
//! the form that python-can 4.6.1 (which splits at single blanks) understands:
//!
//! * data of `frame`: the description separates the bytes, the programs do not;
//! * an id is extended if it has eight digits or a value above 7FF;
//! * a frame without data is written with two blanks before the bracket (`< frame 123 1.000000  >`):
//!   with one, python-can fails to find its data field;
//! * a remote frame is `sendrtr`/`rtr`; python-can sends `send` with a length and no bytes, which is
//!   read as a remote frame too.
//!
//! # Lock step
//!
//! An addition of this project, for programs that share virtual time over a socket. The load of the machine then
//! has no effect: the same programs exchange the same frames at the same times in each run.
//!
//! | who | message | meaning |
//! |---|---|---|
//! | client | `< lockstep >` | after `rawmode`: from now on time waits for this client |
//! | server | `< time T >` | it is T; the frames of T came before; it is the client's turn |
//! | client | `< wait T F >` | its turn is over; it needs the next one at T, or when a frame comes, but for a frame not before F |
//!
//! During its turn a client sends its frames of that time. The server lets time pass only while no client has a
//! turn, up to the next frame or the earliest T. Clients that have a turn at the same time get it one after the
//! other, in the order in which they joined. Times are seconds since the server began, with microseconds.
//!
//! Source: `doc/protocol.md` of the socketcand project; `can/interfaces/socketcand` of python-can.

mod assembler;
mod command;
mod message;

pub use assembler::{Assembled, Assembler};
pub use command::{Command, CommandError};
pub use message::{Message, MessageError};

/// Longest message either side makes or accepts, brackets included, in bytes.
///
/// A data frame needs at most 63; the rest leaves room for the words of an error and for data bytes
/// that are separated by blanks.
pub const MESSAGE_MAX: usize = 128;

/// TCP port of socketcand servers.
pub const DEFAULT_PORT: u16 = 29_536;
