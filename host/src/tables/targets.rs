//! Lists of targets: CSV files whose columns are found by their names, read row by row.

use std::fs::File;
use std::io::{BufRead, BufReader, Seek};
use std::path::{Path, PathBuf};

use super::{add_bytes, reading};
use crate::error::ExpectedError;

/// Columns of a list: those of the point, and groups of which all or none are there.
const POINT: [&str; 3] = ["x_m", "y_m", "z_m"];
const NORMAL: [&str; 3] = ["nx", "ny", "nz"];
const VELOCITY: [&str; 3] = ["vx_m_s", "vy_m_s", "vz_m_s"];
const RADIUS: &str = "radius_m";
const INCIDENCE: &str = "incidence_max_deg";

/// Longest list that is read, bytes.
const LIST_MAX_BYTES: u64 = 16 << 30;
/// One row of a list. Coordinates are those of the base of the arm, z up.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct TargetRow {
    pub(crate) target_m: [f64; 3],
    /// Normal of an opening, to the side from which the ball comes.
    pub(crate) normal: Option<[f64; 3]>,
    pub(crate) radius_m: Option<f64>,
    /// Largest angle between path and normal in degrees.
    pub(crate) incidence_max_deg: Option<f64>,
    pub(crate) velocity_m_s: Option<[f64; 3]>,
}

impl TargetRow {
    /// A point and nothing else, in m.
    pub(crate) fn point(target_m: [f64; 3]) -> Self {
        Self { target_m, normal: None, radius_m: None, incidence_max_deg: None, velocity_m_s: None }
    }
}

/// Where the values of a row stand among the columns of the file.
#[derive(Debug, Clone)]
struct Places {
    point: [usize; 3],
    normal: Option<[usize; 3]>,
    velocity: Option<[usize; 3]>,
    radius: Option<usize>,
    incidence: Option<usize>,
}

impl Places {
    fn find(header: &[String], refuse: &impl Fn(String) -> ExpectedError) -> Result<Self, ExpectedError> {
        let column = |name: &str| header.iter().position(|h| h == name);
        let known = POINT.iter().chain(&NORMAL).chain(&VELOCITY);
        let known = known.chain([&RADIUS, &INCIDENCE]);
        if let Some(unknown) = header.iter().find(|h| !known.clone().any(|k| k == h)) {
            let all = known.copied().collect::<Vec<_>>().join(", ");
            return Err(refuse(format!("column \"{unknown}\" is not known; columns are {all}")));
        }
        let group = |names: [&'static str; 3]| match names.map(column) {
            [Some(a), Some(b), Some(c)] => Ok(Some([a, b, c])),
            [None, None, None] => Ok(None),
            _ => Err(refuse(format!("of the columns {} all or none are needed", names.join(", ")))),
        };
        let point =
            group(POINT)?.ok_or_else(|| refuse(format!("the columns {} are missing", POINT.join(", "))))?;
        let (normal, velocity) = (group(NORMAL)?, group(VELOCITY)?);
        let (radius, incidence) = (column(RADIUS), column(INCIDENCE));
        if normal.is_some() != radius.is_some() {
            return Err(refuse(format!("an opening needs the columns {} and {RADIUS}", NORMAL.join(", "))));
        }
        Ok(Self { point, normal, velocity, radius, incidence })
    }

    /// A row, from the number in each column.
    fn row<E>(&self, number: impl Fn(usize) -> Result<f64, E>) -> Result<TargetRow, E> {
        let three = |at: [usize; 3]| Ok::<_, E>([number(at[0])?, number(at[1])?, number(at[2])?]);
        Ok(TargetRow {
            target_m: three(self.point)?,
            normal: self.normal.map(three).transpose()?,
            radius_m: self.radius.map(&number).transpose()?,
            incidence_max_deg: self.incidence.map(&number).transpose()?,
            velocity_m_s: self.velocity.map(three).transpose()?,
        })
    }
}

/// A list of targets in a file. The file must not change while it is read.
#[derive(Debug, Clone)]
pub(crate) struct TargetList {
    path: PathBuf,
    places: Places,
    header: Vec<String>,
    rows: u64,
    crc32: u32,
}

/// Rows of a list, in order.
pub(crate) type Rows = Box<dyn Iterator<Item = Result<TargetRow, ExpectedError>> + Send>;

impl TargetList {
    /// Opens a list. Goes through the file once: rows are counted, every number is looked at.
    ///
    /// # Errors
    /// The file cannot be read, is longer than 16 GiB, has no target, has a column that is not known, or a field that is not a
    /// number: file, row and column are named.
    pub(crate) fn open(path: &Path) -> Result<Self, ExpectedError> {
        let refuse = |what: String| ExpectedError::bad_input(&format!("{}: {what}", path.display()));
        let data = std::fs::metadata(path).map_err(reading(path))?;
        if !data.is_file() {
            return Err(refuse("a list is read more than once, so it must be a file".to_owned()));
        }
        if data.len() > LIST_MAX_BYTES {
            return Err(refuse(format!("{} bytes; a list has at most {LIST_MAX_BYTES}", data.len())));
        }
        let mut crc32 = crc32fast::Hasher::new();
        add_bytes(path, &mut crc32)?;
        let mut reader = open_csv(path)?;
        let header = reader.headers().map_err(|e| refuse(e.to_string()))?;
        let header: Vec<String> = header.iter().map(str::to_owned).collect();
        let places = Places::find(&header, &refuse)?;
        let mut list = Self { path: path.to_owned(), places, header, rows: 0, crc32: crc32.finalize() };
        for row in list.rows_from(0)? {
            row?;
            list.rows += 1;
        }
        if list.rows == 0 {
            return Err(refuse("there is no target in it".to_owned()));
        }
        Ok(list)
    }

    pub(crate) fn count(&self) -> u64 {
        self.rows
    }

    pub(crate) fn crc32(&self) -> u32 {
        self.crc32
    }

    /// The rows from number `from` (from 0) to the end, one after the other.
    pub(crate) fn rows_from(&self, from: u64) -> Result<Rows, ExpectedError> {
        let (path, places, header) = (self.path.clone(), self.places.clone(), self.header.clone());
        let records = (1_u64..).zip(open_csv(&self.path)?.into_records());
        let records = records.skip(usize::try_from(from).unwrap_or(usize::MAX));
        Ok(Box::new(records.map(move |(row, record)| {
            let refuse = |what: String| ExpectedError::bad_input(&format!("{}: {what}", path.display()));
            let record = record.map_err(|error| refuse(error.to_string()))?;
            places.row(|at| {
                let text = record.get(at).unwrap_or_default();
                text.parse::<f64>().ok().filter(|v| v.is_finite()).ok_or_else(|| {
                    refuse(format!("row {row}, column \"{}\": \"{text}\" is not a finite number", header[at]))
                })
            })
        })))
    }
}

fn open_csv(path: &Path) -> Result<csv::Reader<BufReader<File>>, ExpectedError> {
    let mut file = BufReader::new(File::open(path).map_err(reading(path))?);
    // The mark that some programs put before UTF-8 text.
    let begin = file.fill_buf().map_err(reading(path))?;
    if begin.starts_with(b"PAR1") {
        return Err(ExpectedError::bad_input(&format!("{}: a Parquet file; lists are CSV", path.display()))
            .next(format!(
                "python3 -c \"import pandas; pandas.read_parquet('{}').to_csv('targets.csv', index=False)\"",
                path.display()
            )));
    }
    let mark = begin.starts_with("\u{feff}".as_bytes());
    if mark {
        file.consume(3);
    } else {
        file.rewind().map_err(reading(path))?;
    }
    Ok(csv::ReaderBuilder::new().trim(csv::Trim::All).comment(Some(b'#')).from_reader(file))
}
