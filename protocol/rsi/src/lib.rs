//! Wire format of KUKA.Ethernet RSI XML: the robot sends one `<Rob>` telegram per cycle, the computer answers with one
//! `<Sen>` telegram.
//!
//! The package reads and writes bytes. It holds no socket, no clock and no state of the exchange.
//!
//! ```
//! use rsi_protocol::{Config, Ipoc, RobotState, Root, SensorWriter, Telegram, Value};
//!
//! let config = Config::parse(
//!     r#"<ROOT><CONFIG><IP_NUMBER>192.168.1.2</IP_NUMBER><PORT>49152</PORT><PROTOCOL>UDP</PROTOCOL>
//!        <SENTYPE>ImFree</SENTYPE><ONLYSEND>FALSE</ONLYSEND></CONFIG>
//!        <SEND><ELEMENTS><ELEMENT TAG="DEF_AIPos" TYPE="DOUBLE" INDX="INTERNAL"/></ELEMENTS></SEND>
//!        <RECEIVE><ELEMENTS><ELEMENT TAG="AK.A1" TYPE="DOUBLE" INDX="1" HOLDON="1"/></ELEMENTS></RECEIVE></ROOT>"#,
//! )
//! .unwrap();
//! let received = br#"<Rob Type="KUKA"><AIPos A1="0.0" A2="-90.0" A3="90.0" A4="0.0" A5="90.0" A6="0.0"/><IPOC>0042</IPOC></Rob>"#;
//! let telegram = Telegram::parse(received, Root::Rob).unwrap();
//! let state = RobotState::read(&telegram).unwrap();
//! assert_eq!(state.aipos_deg.unwrap()[1], -90.0);
//!
//! let answer = SensorWriter::new(&config, 6).write(telegram.ipoc, |_| Some(Value::Double(0.5))).unwrap();
//! assert_eq!(answer, br#"<Sen Type="ImFree"><AK A1="0.500000"/><IPOC>0042</IPOC></Sen>"#);
//! ```
//!
//! # Map
//!
//! | module | holds |
//! |---|---|
//! | `telegram` | [`Telegram`]: both documents, read by name, written in order |
//! | `robot` | [`RobotState`]: data that a client reads; [`RobotWriter`]: telegrams that a controller sends |
//! | `sensor` | [`SensorWriter`]: answers that a client sends; [`read_answer`]: a controller reads them |
//! | [`config`] | the configuration file of the controller |
//! | `stream` | [`Framer`]: documents out of a TCP byte stream |
//! | `ipoc` | [`Ipoc`]: the number that ties an answer to its telegram, with its digits |
//! | `generation` | [`Generation`]: differences between KR C2 and KR C4 |
//! | `names` | names of attributes: axes, coordinates |
//! | `value`, `xml`, `error` | typed values and decimals, the step to and from XML, errors |
//!
//! # Reading rules
//!
//! Elements are read by name, never by order. Unknown elements are skipped. `"/>` and `" />`, white space, CR LF and NUL
//! at the end are all accepted, and so is a root without `Type` or with the name in other letters (`TYPE`). A document
//! type declaration is refused, so there are no entities to expand. Every size is bounded.

pub mod config;
mod error;
mod generation;
mod ipoc;
mod names;
mod robot;
mod sensor;
mod stream;
mod telegram;
mod value;
mod xml;

pub use config::{Config, Internal, Protocol, ReceiveEntry, SendEntry, Source, Tag};
pub use error::{ConfigError, ConfigProblem, ReadError, WriteError};
pub use generation::Generation;
pub use ipoc::Ipoc;
pub use names::{AXIS_NAMES, CARTESIAN_NAMES, EXTERNAL_NAMES};
pub use robot::{RobotData, RobotState, RobotWriter};
pub use sensor::{SensorWriter, read_answer};
pub use stream::{Framer, StreamItem};
pub use telegram::{Element, Root, Telegram};
pub use value::{Value, ValueType, parse_decimal};

/// Longest document that is written, in bytes: public programs have buffers of 1024 bytes.
pub const MAX_WRITTEN_BYTES: usize = 1023;
/// Longest document that is read, in bytes.
pub const MAX_READ_BYTES: usize = 4096;
/// Longest configuration file, in bytes.
pub const MAX_CONFIG_BYTES: usize = 65_536;
/// Most nodes (elements and texts) of one telegram.
pub const MAX_NODES: usize = 512;
