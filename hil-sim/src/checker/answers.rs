//! Every request is answered in time, and every answer belongs to a request.

use std::collections::VecDeque;

use protocol::powercube::{Address, AddressedRequest, Channel, Reply, Request};
use protocol::{Duration, Frame, Instant, ModuleId};

use super::{Checker, Findings};

/// Requests open at one module; more are not tracked, as no module queues that many.
const OPEN_MAX: usize = 64;

/// Checker of requests and answers. STATE frames come unasked and are left out.
#[derive(Clone, Debug)]
pub struct Answers {
    within: Duration,
    /// By module, in ascending order: open requests, oldest first.
    modules: Vec<(ModuleId, VecDeque<(Instant, Request)>)>,
}

impl Answers {
    /// Expects the answers of these modules.
    pub fn new(within: Duration, modules: impl Iterator<Item = ModuleId>) -> Self {
        let mut modules: Vec<_> = modules.map(|module| (module, VecDeque::new())).collect();
        modules.sort_by_key(|(module, _)| *module);
        Self { within, modules }
    }

    fn open(&mut self, module: ModuleId) -> Option<&mut VecDeque<(Instant, Request)>> {
        let at = self.modules.binary_search_by_key(&module, |(known, _)| *known).ok()?;
        Some(&mut self.modules[at].1)
    }

    fn expire(&mut self, now: Instant, findings: &mut Findings) {
        let within = self.within;
        for (module, open) in &mut self.modules {
            while let Some((at, request)) = open.front()
                && *at + within < now
            {
                findings.add(*at + within, Some(*module), || format!("no answer to {request:?} of {at} s"));
                open.pop_front();
            }
        }
    }
}

impl Checker for Answers {
    fn on_frame(&mut self, at: Instant, frame: &Frame, findings: &mut Findings) {
        self.expire(at, findings);
        if let Ok(AddressedRequest { module, request, .. }) = AddressedRequest::decode(frame) {
            if let Some(open) = self.open(module)
                && open.len() < OPEN_MAX
            {
                open.push_back((at, request));
            }
            return;
        }
        let (module, reply) = match Reply::decode(frame) {
            Ok((_, Reply::State(_))) => return,
            Ok(reply) => reply,
            Err(_) => {
                if let Some(Address::Module(Channel::Ack, module)) = Address::of(frame.id()) {
                    findings.add(at, Some(module), || format!("{frame} is no answer of this protocol"));
                }
                return;
            }
        };
        let Some(open) = self.open(module) else { return };
        match open.iter().position(|(_, request)| reply.answers(request)) {
            // An answer out of order means that an earlier one was lost or overtaken; the earlier request stays
            // open until its time is over.
            Some(index) => {
                open.remove(index);
            }
            None => findings.add(at, Some(module), || format!("{reply:?} answers nothing that was asked")),
        }
    }

    fn finish(&mut self, end: Instant, findings: &mut Findings) {
        self.expire(end, findings);
    }
}
