//! The folder of results of a job.

use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

use operator::bus::BusArgs;
use planner::store::file::write_whole;

use crate::error::ExpectedError;
use crate::exit;

/// Where the results go.
pub(super) struct Folder {
    pub(super) path: PathBuf,
}

impl Folder {
    pub(super) fn create(wanted: Option<&Path>) -> Result<Self, ExpectedError> {
        let path = wanted.map_or_else(|| PathBuf::from(format!("throw-{}", date_and_time())), Path::to_owned);
        std::fs::create_dir_all(&path).map_err(|error| elsewhere(format!("{}: {error}", path.display())))?;
        let this = Self { path };
        for name in ["summary.json", "bus.log", "log.candump"] {
            if this.file(name).is_file() {
                return Err(elsewhere(format!("{} holds the results of another run", this.path.display())));
            }
        }
        Ok(this)
    }

    /// The folder `out`, if one is named, and the recording of `bus` in it.
    pub(super) fn recording(out: Option<&Path>, bus: &mut BusArgs) -> Result<Option<Self>, ExpectedError> {
        let folder = out.map(|out| Self::create(Some(out))).transpose()?;
        if let Some(folder) = &folder {
            bus.record = Some(folder.file("bus"));
        }
        Ok(folder)
    }

    pub(super) fn file(&self, name: &str) -> PathBuf {
        self.path.join(name)
    }

    pub(super) fn write(&self, name: &str, text: &str) -> Result<(), ExpectedError> {
        let path = self.file(name);
        write_whole(&path, text.as_bytes()).map_err(|error| ExpectedError::output(&path, &error))
    }
}

/// `20261121-025700` in UTC.
fn date_and_time() -> String {
    let s = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_secs());
    let (days, s) = (s / 86_400, s % 86_400);
    // Days since 1 March of year 0 in the proleptic Gregorian calendar, in eras of 400 years.
    let days = days + 719_468;
    let (era, of_era) = (days / 146_097, days % 146_097);
    let year_of_era = (of_era - of_era / 1_460 + of_era / 36_524 - of_era / 146_096) / 365;
    let of_year = of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
    let (month, day) = ((5 * of_year + 2) / 153, of_year - (153 * ((5 * of_year + 2) / 153) + 2) / 5 + 1);
    let (year, month) = (era * 400 + year_of_era + u64::from(month >= 10), (month + 2) % 12 + 1);
    format!("{year:04}{month:02}{day:02}-{:02}{:02}{:02}", s / 3_600, s / 60 % 60, s % 60)
}

fn elsewhere(what: String) -> ExpectedError {
    ExpectedError::new(exit::OUTPUT, what).next("name another folder with --out")
}

#[cfg(test)]
mod tests {
    #[test]
    fn the_default_folder_is_named_after_a_date_of_this_century() {
        let name = super::date_and_time();
        assert!(name.len() == 15 && name.starts_with("20") && name.as_bytes()[8] == b'-', "{name}");
    }
}
