//! A terminal for the program under test: what it shows there is read, and keys are typed.

use std::fs::File;
use std::io::{BufRead, BufReader, Read, Write};
use std::process::{Child, Command, Stdio};

use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};

/// The near and the far end of a terminal.
fn terminal() -> (File, File) {
    let near = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC).unwrap();
    grantpt(&near).unwrap();
    unlockpt(&near).unwrap();
    let path = ptsname(&near, Vec::new()).unwrap();
    let far = File::options().read(true).write(true).open(path.to_str().unwrap()).unwrap();
    (File::from(near), far)
}

pub(crate) struct AtTerminal {
    near: File,
    program: Child,
    seen: String,
}

impl AtTerminal {
    /// Runs it with these words; standard output is not at the terminal.
    pub(crate) fn run(words: &[&str]) -> Self {
        let (near, far) = terminal();
        let program = Command::new(env!("CARGO_BIN_EXE_cubectl"))
            .args(words)
            .env("TERM", "xterm")
            .stdin(far.try_clone().unwrap())
            .stdout(Stdio::piped())
            .stderr(far)
            .spawn()
            .expect("runs");
        Self { near, program, seen: String::new() }
    }

    /// The next line on standard output.
    pub(crate) fn says(&mut self) -> String {
        let mut line = String::new();
        BufReader::new(self.program.stdout.as_mut().unwrap()).read_line(&mut line).unwrap();
        line
    }

    /// Ctrl-C: it is no terminal that controls the program, so the signal is sent.
    pub(crate) fn interrupts(&self) {
        let id = rustix::process::Pid::from_child(&self.program);
        rustix::process::kill_process(id, rustix::process::Signal::INT).unwrap();
    }

    pub(crate) fn types(&mut self, keys: &str) {
        self.near.write_all(keys.as_bytes()).unwrap();
    }

    /// Reads on; false once the program has ended.
    fn read(&mut self) -> bool {
        let mut some = [0; 4096];
        // A terminal without a program behind it is an error (EIO).
        let Ok(count @ 1..) = self.near.read(&mut some) else { return false };
        self.seen += &String::from_utf8_lossy(&some[..count]);
        true
    }

    /// Waits until the program shows a text, and forgets what it has shown until then; returns that.
    pub(crate) fn sees(&mut self, wanted: &str) -> String {
        loop {
            if let Some(at) = self.seen.find(wanted) {
                return self.seen.drain(..at + wanted.len()).collect();
            }
            assert!(self.read(), "it ended without \"{wanted}\": {}", self.seen);
        }
    }

    /// Waits for the end: exit code, and what it has written to standard output and shown.
    pub(crate) fn ends(mut self) -> (i32, String, String) {
        while self.read() {}
        let Self { program, seen, .. } = self;
        let output = program.wait_with_output().unwrap();
        (output.status.code().unwrap(), String::from_utf8(output.stdout).unwrap(), seen)
    }

    pub(crate) fn kill(mut self) {
        self.program.kill().expect("it runs or has ended");
        self.program.wait().expect("waits");
    }
}
