//! A search with its options: one type for programs that let the user choose the form.

use super::best::{self, BestOptions};
use super::found::{Found, NotFound};
use super::paper::{self, PaperOptions};
use super::plan::Form;
use super::setting::Setting;

/// A form of planning and its options.
#[derive(Clone)]
pub enum Search {
    /// The form of the paper.
    Paper(PaperOptions),
    /// The longest window without a grid.
    Best(BestOptions),
}

impl Search {
    /// Plans a throw.
    ///
    /// # Errors
    ///
    /// What refused the candidates, if none is left.
    pub fn plan(&self, setting: &Setting<'_>) -> Result<Found, Box<NotFound>> {
        match self {
            Self::Paper(options) => paper::plan(setting, options),
            Self::Best(options) => best::plan(setting, options),
        }
    }

    /// The form as it stands in the plan file.
    #[must_use]
    pub const fn form(&self) -> Form {
        match self {
            Self::Paper(_) => Form::Paper,
            Self::Best(options) => Form::Best(options.hand),
        }
    }
}
