//! Arguments of a verb from words of a command line that no shell has given.

use clap::{Args, FromArgMatches};

use crate::error::ExpectedError;
use crate::exit;

/// The arguments of the verb `name`; `words` are those behind it.
///
/// # Errors
/// What the program itself would say of them, with [`exit::USAGE`].
pub(crate) fn parse<A: Args + FromArgMatches>(
    name: &'static str,
    words: &[String],
) -> Result<A, ExpectedError> {
    let verb =
        A::augment_args(clap::Command::new(name).bin_name(format!("cubectl {name}")).no_binary_name(true));
    let refused = |error: clap::Error| ExpectedError::new(exit::USAGE, error.to_string().trim_end());
    let matches = verb.try_get_matches_from(words).map_err(refused)?;
    A::from_arg_matches(&matches).map_err(refused)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cmd::plan::args::Args as PlanArgs;

    fn words(text: &str) -> Vec<String> {
        text.split(' ').map(str::to_owned).collect()
    }

    #[test]
    fn words_are_those_of_the_program_and_so_are_refusals() {
        let args: PlanArgs = parse("plan throw", &words("--target=1,-2,3 --seed 7 --fast")).unwrap();
        assert_eq!((args.target, args.seed, args.fast), ([1.0, -2.0, 3.0], 7, true));
        let refused = parse::<PlanArgs>("plan throw", &words("--target=1,2")).unwrap_err();
        assert_eq!(refused.code, exit::USAGE);
        assert!(refused.what.contains("expected 3 numbers separated by commas, got 2"), "{}", refused.what);
    }
}
