//! Errors that are expected: the user, a file or the outside world, not a bug.

use std::fmt;

use rustix::io::Errno;

use crate::exit;

/// What happened, where, and what to do next; ends the program with a documented exit code.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ExpectedError {
    /// Exit code, one of [`crate::exit`].
    pub code: u8,
    /// Text for people.
    pub message: String,
}

impl fmt::Display for ExpectedError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.message)
    }
}

impl std::error::Error for ExpectedError {}

/// Before a next step in a message.
const NEXT: &str = "  next: ";

/// What to do if the system says this of a file.
const FILE_ERRORS: [(Errno, &str); 4] = [
    (
        Errno::NOENT,
        "check the name of the file; a name without a leading slash counts from the folder in which the command runs",
    ),
    (Errno::ACCESS, "ask for the right to the file and its folder (`ls -l`), or use another file"),
    (Errno::ISDIR, "name a file in that folder"),
    (Errno::NOTDIR, "check the folders in the name: one of them is a file"),
];

/// As [`std::io::Error`] says it.
fn system_text(errno: Errno) -> String {
    std::io::Error::from(errno).to_string()
}

impl ExpectedError {
    /// With an exit code. A file that the system refuses gets a next step here if the message has none: whoever reads files
    /// need not think of it.
    #[must_use]
    pub fn new(code: u8, message: impl Into<String>) -> Self {
        let mut message = message.into();
        if !message.contains("next:") {
            let next = FILE_ERRORS.iter().find(|(errno, _)| message.contains(&system_text(*errno)));
            if let Some((_, next)) = next {
                message += &format!("\n{NEXT}{next}");
            }
        }
        Self { code, message }
    }

    /// The one object of a failure with `--json`: exit code, what happened, and the next steps.
    #[must_use]
    pub fn json(&self) -> serde_json::Value {
        let (what, next) = self.parts();
        serde_json::json!({ "code": self.code, "what": what, "next": next })
    }

    /// What happened, and the next steps.
    #[must_use]
    pub fn parts(&self) -> (String, Vec<&str>) {
        let (next, what): (Vec<&str>, Vec<&str>) =
            self.message.lines().partition(|line| line.starts_with(NEXT));
        (what.join("\n"), next.into_iter().filter_map(|line| line.strip_prefix(NEXT)).collect())
    }

    /// Refused input.
    #[must_use]
    pub fn bad_input(cause: &impl fmt::Display) -> Self {
        Self::new(exit::BAD_INPUT, cause.to_string())
    }

    /// A result that cannot be written.
    #[must_use]
    pub fn output(path: &std::path::Path, cause: &std::io::Error) -> Self {
        Self::new(exit::OUTPUT, format!("{}: {cause}", path.display()))
    }

    /// A file that cannot be read.
    #[must_use]
    pub fn io(path: &std::path::Path, cause: &std::io::Error) -> Self {
        Self::new(exit::BAD_INPUT, format!("{}: {cause}", path.display()))
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;

    #[test]
    fn a_file_that_is_missing_gets_one_next_step() {
        let folder = std::env::temp_dir();
        for (path, next) in [(folder.join("no-such-file.toml"), "check the name"), (folder, "in that folder")]
        {
            let cause = std::fs::read(&path).unwrap_err();
            let error = ExpectedError::io(&path, &cause);
            assert!(error.message.contains(next), "{error}");
            let told = ExpectedError::new(error.code, error.message);
            assert_eq!(told.message.matches("next:").count(), 1, "{told}");
        }
        let own = ExpectedError::io(Path::new("x"), &std::io::Error::other("broken\n  next: mend it"));
        assert_eq!(own.message.matches("next:").count(), 1, "{own}");
        assert!(!ExpectedError::bad_input(&"two numbers").message.contains("next:"));
    }
}
