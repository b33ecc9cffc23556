//! Questions to drives, one or many at once, on a session.

use std::collections::BTreeMap;

use protocol::powercube::{Parameter, Reply, Request, SimpleCommand, Value};
use protocol::{Duration, Instant, ModuleId};

use crate::bus::BusFailure;
use crate::bus::session::{Ended, Session};
use crate::node::drive_client::RequestFailed;

/// Why a question has no answer.
#[derive(Debug, thiserror::Error)]
pub enum AskError {
    #[error(transparent)]
    Bus(#[from] BusFailure),
    /// The module did not answer, or refused.
    #[error("{0}")]
    Request(#[from] RequestFailed),
    /// Ctrl-C.
    #[error("interrupted")]
    Interrupted,
}

impl AskError {
    /// What to do.
    #[must_use]
    pub fn next(&self) -> Option<String> {
        Some(match self {
            Self::Request(..) => {
                "check power, cable and address of the module; `cubectl doctor` looks at the bus".to_owned()
            }
            Self::Bus(error) => return error.next(),
            _ => return None,
        })
    }
}

/// Most time that all requests of one round may take; far beyond what the deadlines of the client allow.
const ROUND_MAX: Duration = Duration::from_secs(60);

/// Hosts known to us poll at least this often; the controller every 10 ms.
pub const OTHERS_LISTEN: Duration = Duration::from_millis(100);

impl Session {
    /// Sends requests to several modules at once; answers in the order of the requests.
    ///
    /// # Errors
    /// [`AskError::Bus`], [`AskError::Interrupted`]; what single modules do is in the list.
    pub fn ask_all(
        &mut self,
        questions: &[(ModuleId, Request)],
    ) -> Result<Vec<Result<Reply, RequestFailed>>, AskError> {
        self.ask_all_with(questions, &mut |_, _| {})
    }

    /// As [`Session::ask_all`]; `progress` gets the number of ended requests and of all requests.
    pub fn ask_all_with(
        &mut self,
        questions: &[(ModuleId, Request)],
        progress: &mut dyn FnMut(usize, usize),
    ) -> Result<Vec<Result<Reply, RequestFailed>>, AskError> {
        let mut results: Vec<Option<Result<Reply, RequestFailed>>> = vec![None; questions.len()];
        let mut open = BTreeMap::new();
        let host_node = self.host_node();
        while host_node.poll_outcome().is_some() {}
        for (index, (module, request)) in questions.iter().enumerate() {
            match host_node.start(*module, *request) {
                Ok(ticket) => {
                    open.insert(ticket, index);
                }
                Err(failed) => results[index] = Some(Err(failed)),
            }
        }
        let until = self.now() + ROUND_MAX;
        let ended = self.run(until, &mut |host_node| {
            while let Some(outcome) = host_node.poll_outcome() {
                if let Some(index) = open.remove(&outcome.ticket) {
                    results[index] = Some(outcome.result);
                    progress(questions.len() - open.len(), questions.len());
                }
            }
            open.is_empty()
        })?;
        if ended == Ended::Interrupted {
            self.host_node().drives.cancel_all();
            return Err(AskError::Interrupted);
        }
        let tries = self.host_node().drives.policy().tries;
        Ok(results
            .into_iter()
            .zip(questions)
            .map(|(result, (module, request))| {
                result.unwrap_or(Err(RequestFailed::NoAnswer { module: *module, request: *request, tries }))
            })
            .collect())
    }

    pub fn ask(&mut self, module: ModuleId, request: Request) -> Result<Reply, AskError> {
        let answer = self.ask_all(&[(module, request)])?.into_iter().next();
        Ok(answer.unwrap_or(Err(RequestFailed::NoAnswer { module, request, tries: 0 }))?)
    }

    pub fn get(&mut self, module: ModuleId, parameter: Parameter) -> Result<Value, AskError> {
        let request = Request::Get(parameter);
        match self.ask(module, request)? {
            Reply::Value(_, value) => Ok(value),
            // `answers` has matched the kind of reply already.
            _ => Err(RequestFailed::NoAnswer { module, request, tries: 1 }.into()),
        }
    }

    /// Reads a number.
    pub fn get_f64(&mut self, module: ModuleId, parameter: Parameter) -> Result<f64, AskError> {
        Ok(self.get(module, parameter)?.as_f64().unwrap_or(f64::NAN))
    }

    /// Writes a float parameter.
    pub fn set_f32(&mut self, module: ModuleId, parameter: Parameter, value: f32) -> Result<(), AskError> {
        self.ask(module, Request::Set(parameter, Value::F32(value))).map(drop)
    }

    /// Gives a one-byte command.
    pub fn command(&mut self, module: ModuleId, command: SimpleCommand) -> Result<(), AskError> {
        self.ask(module, Request::Simple(command)).map(drop)
    }

    /// Listens for [`OTHERS_LISTEN`]: true if another node sends requests or orders to the drives.
    ///
    /// # Errors
    /// [`AskError::Bus`], [`AskError::Interrupted`].
    pub fn hears_other_host(&mut self) -> Result<bool, AskError> {
        let before = self.host_node().tally().foreign_requests;
        let until = self.now() + OTHERS_LISTEN;
        let ended = self.run(until, &mut |host_node| host_node.tally().foreign_requests > before)?;
        match ended {
            Ended::Interrupted => Err(AskError::Interrupted),
            Ended::Done => Ok(true),
            Ended::TimedOut => Ok(false),
        }
    }

    /// Waits until `until`, listening.
    ///
    /// # Errors
    /// [`AskError::Bus`], [`AskError::Interrupted`].
    pub fn sleep_until(&mut self, until: Instant) -> Result<(), AskError> {
        match self.run(until, &mut |_| false)? {
            Ended::Interrupted => Err(AskError::Interrupted),
            Ended::Done | Ended::TimedOut => Ok(()),
        }
    }
}
