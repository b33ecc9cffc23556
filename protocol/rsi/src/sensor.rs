//! Computer to robot.

use crate::config::{Config, ReceiveEntry};
use crate::error::{ReadError, WriteError};
use crate::ipoc::Ipoc;
use crate::telegram::{Root, Telegram};
use crate::value::Value;

/// Writes answers in the order of a configuration file.
#[derive(Clone, Debug)]
pub struct SensorWriter<'c> {
    config: &'c Config,
    decimals: u8,
}

impl<'c> SensorWriter<'c> {
    /// For the `RECEIVE` part of `config`, with this number of decimals (4 to 6 are usual).
    #[must_use]
    pub fn new(config: &'c Config, decimals: u8) -> Self {
        Self { config, decimals }
    }

    /// An answer to the telegram numbered `ipoc`; an entry without a value is left out.
    ///
    /// # Errors
    /// A value has another type than its entry or cannot be written, or the document is too long.
    pub fn write(
        &self,
        ipoc: Ipoc,
        value: impl Fn(&ReceiveEntry) -> Option<Value>,
    ) -> Result<Vec<u8>, WriteError> {
        let mut elements = Vec::new();
        for entry in &self.config.receive {
            if let Some(value) = value(entry) {
                let text = value.text(&entry.tag.to_string(), entry.kind, self.decimals)?;
                entry.tag.put(&mut elements, text);
            }
        }
        let kind = Some(self.config.sentype.clone());
        Telegram { root: Root::Sen, kind, elements, ipoc }.write()
    }
}

/// Reads the values of an answer, one place per entry of `config.receive`; `None` where the answer holds none.
///
/// # Errors
/// A value is not of the type of its entry. The whole answer is then refused: half an answer would move some axes and
/// leave others.
pub fn read_answer(telegram: &Telegram, config: &Config) -> Result<Vec<Option<Value>>, ReadError> {
    let read = |entry: &ReceiveEntry| {
        let Some(element) = telegram.element(&entry.tag.element) else { return Ok(None) };
        let text = match &entry.tag.attribute {
            Some(attribute) => element.attribute(attribute),
            None => Some(element.text.as_str()),
        };
        text.map(|text| entry.kind.read(&entry.tag.to_string(), text)).transpose()
    };
    config.receive.iter().map(read).collect()
}
