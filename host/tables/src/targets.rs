//! Lists of targets: CSV and Parquet files with the same columns, found by their names and read row by row.

use std::fs::File;
use std::io::{BufRead, BufReader, Read, Seek};
use std::path::{Path, PathBuf};

use parquet::column::reader::ColumnReader;
use parquet::errors::ParquetError;
use parquet::file::reader::{FileReader, SerializedFileReader};

use crate::error::{TableError, system};

/// Columns of a list: those of the point, and groups of which all or none are there.
const POINT: [&str; 3] = ["x_m", "y_m", "z_m"];
const NORMAL: [&str; 3] = ["nx", "ny", "nz"];
const VELOCITY: [&str; 3] = ["vx_m_s", "vy_m_s", "vz_m_s"];
const RADIUS: &str = "radius_m";
const INCIDENCE: &str = "incidence_max_deg";

/// Longest list that is read, bytes.
const LIST_MAX_BYTES: u64 = 16 << 30;
/// Rows of a Parquet list that are read at once.
const BATCH_ROWS: usize = 8192;

/// One row of a list. Coordinates are those of the base of the arm, z up.
#[derive(Debug, Clone, PartialEq)]
pub struct TargetRow {
    /// The point in m.
    pub target_m: [f64; 3],
    /// Normal of an opening, to the side from which the ball comes.
    pub normal: Option<[f64; 3]>,
    /// Radius of the opening in m.
    pub radius_m: Option<f64>,
    /// Largest angle between path and normal in degrees.
    pub incidence_max_deg: Option<f64>,
    /// Velocity of the target in m/s.
    pub velocity_m_s: Option<[f64; 3]>,
}

impl TargetRow {
    /// A point and nothing else, in m.
    #[must_use]
    pub fn point(target_m: [f64; 3]) -> Self {
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
    fn find(header: &[String], refuse: &impl Fn(String) -> TableError) -> Result<Self, TableError> {
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
pub struct TargetList {
    path: PathBuf,
    parquet: bool,
    places: Places,
    header: Vec<String>,
    rows: u64,
    crc32: u32,
}

/// Rows of a list, in order.
pub type Rows = Box<dyn Iterator<Item = Result<TargetRow, TableError>> + Send>;

impl TargetList {
    /// Opens a list; what ends in `.parquet` is Parquet, all else CSV. Goes through the file once: rows are counted, in CSV
    /// every number is looked at.
    ///
    /// # Errors
    /// The file cannot be read, is longer than 16 GiB, has no target, or has a column or a number that is none: file, row and
    /// column are named.
    pub fn open(path: &Path) -> Result<Self, TableError> {
        let refuse = |what: String| TableError::Refused(format!("{}: {what}", path.display()));
        let data = std::fs::metadata(path).map_err(TableError::reading(path))?;
        if !data.is_file() {
            return Err(refuse("a list is read more than once, so it must be a file".to_owned()));
        }
        if data.len() > LIST_MAX_BYTES {
            return Err(refuse(format!("{} bytes; a list has at most {LIST_MAX_BYTES}", data.len())));
        }
        let crc32 = crc32_of(path)?;
        let parquet = path.extension().is_some_and(|e| e.eq_ignore_ascii_case("parquet"));
        let list = if parquet {
            let reader = open_parquet(path)?;
            let schema = reader.metadata().file_metadata().schema_descr();
            let header: Vec<String> = schema.columns().iter().map(|c| c.path().string()).collect();
            let places = Places::find(&header, &refuse)?;
            let rows = u64::try_from(reader.metadata().file_metadata().num_rows()).unwrap_or(0);
            Self { path: path.to_owned(), parquet, places, header, rows, crc32 }
        } else {
            let mut reader = open_csv(path)?;
            let header = reader.headers().map_err(|e| refuse(e.to_string()))?;
            let header: Vec<String> = header.iter().map(str::to_owned).collect();
            let places = Places::find(&header, &refuse)?;
            let mut list = Self { path: path.to_owned(), parquet, places, header, rows: 0, crc32 };
            let mut rows = 0;
            for row in list.csv_rows(0)? {
                row?;
                rows += 1;
            }
            list.rows = rows;
            list
        };
        if list.rows == 0 {
            return Err(refuse("there is no target in it".to_owned()));
        }
        Ok(list)
    }

    /// Number of targets.
    #[must_use]
    pub fn len(&self) -> u64 {
        self.rows
    }

    /// Never: a list without a target is refused.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.rows == 0
    }

    /// CRC-32 of the file.
    #[must_use]
    pub fn crc32(&self) -> u32 {
        self.crc32
    }

    /// The rows from number `from` (from 0) to the end, one after the other. Of a Parquet file a batch is in memory.
    ///
    /// # Errors
    /// The file cannot be opened.
    pub fn rows_from(&self, from: u64) -> Result<Rows, TableError> {
        if self.parquet { self.parquet_rows(from) } else { self.csv_rows(from) }
    }

    fn csv_rows(&self, from: u64) -> Result<Rows, TableError> {
        let (path, places, header) = (self.path.clone(), self.places.clone(), self.header.clone());
        let records = (1_u64..).zip(open_csv(&self.path)?.into_records());
        let records = records.skip(usize::try_from(from).unwrap_or(usize::MAX));
        Ok(Box::new(records.map(move |(row, record)| {
            let refuse = |what: String| TableError::Refused(format!("{}: {what}", path.display()));
            let record = record.map_err(|error| refuse(error.to_string()))?;
            places.row(|at| {
                let text = record.get(at).unwrap_or_default();
                text.parse::<f64>().ok().filter(|v| v.is_finite()).ok_or_else(|| {
                    refuse(format!("row {row}, column \"{}\": \"{text}\" is not a finite number", header[at]))
                })
            })
        })))
    }

    fn parquet_rows(&self, from: u64) -> Result<Rows, TableError> {
        let reader = open_parquet(&self.path)?;
        let mut skip = from;
        let mut group = 0;
        while group < reader.num_row_groups() {
            let rows = u64::try_from(reader.metadata().row_group(group).num_rows()).unwrap_or(0);
            if skip < rows {
                break;
            }
            skip -= rows;
            group += 1;
        }
        Ok(Box::new(ParquetRows {
            list: self.clone(),
            reader,
            group,
            skip: usize::try_from(skip).unwrap_or(usize::MAX),
            columns: Vec::new(),
            left: 0,
            batch: Vec::new(),
            next: 0,
            number: from,
            ended: false,
        }))
    }
}

fn crc32_of(path: &Path) -> Result<u32, TableError> {
    let mut file = File::open(path).map_err(TableError::reading(path))?;
    let mut crc = crc32fast::Hasher::new();
    let mut bytes = vec![0; 1 << 16];
    loop {
        match file.read(&mut bytes).map_err(TableError::reading(path))? {
            0 => return Ok(crc.finalize()),
            count => crc.update(&bytes[..count]),
        }
    }
}

fn open_csv(path: &Path) -> Result<csv::Reader<BufReader<File>>, TableError> {
    let mut file = BufReader::new(File::open(path).map_err(TableError::reading(path))?);
    // The mark that some programs put before UTF-8 text.
    let mark = file.fill_buf().map_err(TableError::reading(path))?.starts_with("\u{feff}".as_bytes());
    if mark {
        file.consume(3);
    } else {
        file.rewind().map_err(TableError::reading(path))?;
    }
    Ok(csv::ReaderBuilder::new().trim(csv::Trim::All).comment(Some(b'#')).from_reader(file))
}

fn open_parquet(path: &Path) -> Result<SerializedFileReader<File>, TableError> {
    let file = File::open(path).map_err(TableError::reading(path))?;
    SerializedFileReader::new(file).map_err(|error| not_parquet(path, &error))
}

fn not_parquet(path: &Path, error: &ParquetError) -> TableError {
    TableError::Refused(format!("{}: not a Parquet file that is read here: {error}", path.display()))
}

/// Rows of a Parquet file.
struct ParquetRows {
    list: TargetList,
    reader: SerializedFileReader<File>,
    /// The next row group.
    group: usize,
    /// Rows of it that are left out.
    skip: usize,
    /// Columns of the row group under way, as in the header, and its rows that are not read yet.
    columns: Vec<ColumnReader>,
    left: usize,
    /// Values of each column of the batch under way, and the next row of it.
    batch: Vec<Vec<f64>>,
    next: usize,
    /// Row of the file, from 0.
    number: u64,
    ended: bool,
}

impl ParquetRows {
    /// The next batch; `false` at the end of the file.
    fn read(&mut self) -> Result<bool, TableError> {
        let path = self.list.path.clone();
        let fail = |error: ParquetError| match error {
            ParquetError::External(_) => TableError::reading(&path)(system(error)),
            other => not_parquet(&path, &other),
        };
        while self.left == 0 {
            if self.group >= self.reader.num_row_groups() {
                return Ok(false);
            }
            let group = self.reader.get_row_group(self.group).map_err(fail)?;
            self.left = usize::try_from(group.metadata().num_rows()).unwrap_or(0);
            self.columns.clear();
            for at in 0..self.list.header.len() {
                self.columns.push(group.get_column_reader(at).map_err(fail)?);
            }
            self.group += 1;
            if self.skip > 0 {
                for column in &mut self.columns {
                    skip(column, self.skip).map_err(fail)?;
                }
                self.left = self.left.saturating_sub(self.skip);
                self.skip = 0;
            }
        }
        let rows = self.left.min(BATCH_ROWS);
        self.batch.clear();
        for (at, column) in self.columns.iter_mut().enumerate() {
            let values = numbers(column, rows).map_err(fail)?;
            let Some(values) = values.filter(|values| values.len() == rows) else {
                return Err(TableError::Refused(format!(
                    "{}: column \"{}\" has an empty place, or is no column of single numbers",
                    path.display(),
                    self.list.header[at]
                )));
            };
            self.batch.push(values);
        }
        (self.left, self.next) = (self.left - rows, 0);
        Ok(true)
    }

    fn row(&mut self) -> Result<Option<TargetRow>, TableError> {
        if self.next >= self.batch.first().map_or(0, Vec::len) && !self.read()? {
            return Ok(None);
        }
        let (next, number) = (self.next, self.number);
        (self.next, self.number) = (next + 1, number + 1);
        let row = self.list.places.row(|at| {
            let value = self.batch[at][next];
            value.is_finite().then_some(value).ok_or_else(|| {
                TableError::Refused(format!(
                    "{}: row {}, column \"{}\": {value} is not a finite number",
                    self.list.path.display(),
                    number + 1,
                    self.list.header[at]
                ))
            })
        });
        row.map(Some)
    }
}

impl Iterator for ParquetRows {
    type Item = Result<TargetRow, TableError>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.ended {
            return None;
        }
        let row = self.row().transpose();
        self.ended = !matches!(row, Some(Ok(_)));
        row
    }
}

fn skip(column: &mut ColumnReader, rows: usize) -> Result<(), ParquetError> {
    match column {
        ColumnReader::DoubleColumnReader(reader) => reader.skip_records(rows).map(drop),
        ColumnReader::FloatColumnReader(reader) => reader.skip_records(rows).map(drop),
        ColumnReader::Int64ColumnReader(reader) => reader.skip_records(rows).map(drop),
        ColumnReader::Int32ColumnReader(reader) => reader.skip_records(rows).map(drop),
        // Refused when it is read.
        _ => Ok(()),
    }
}

/// The next `rows` numbers of a column, without those that are missing; `None` for a column that has no numbers.
fn numbers(column: &mut ColumnReader, rows: usize) -> Result<Option<Vec<f64>>, ParquetError> {
    // Which rows have a value is not kept: one that is missing is noticed by the count.
    let (mut there, mut repeated) = (Vec::new(), Vec::new());
    macro_rules! read {
        ($reader:expr, $as_double:expr) => {{
            let mut values = Vec::new();
            $reader.read_records(rows, Some(&mut there), Some(&mut repeated), &mut values)?;
            Ok(Some(values.into_iter().map($as_double).collect()))
        }};
    }
    match column {
        ColumnReader::DoubleColumnReader(reader) => read!(reader, |v: f64| v),
        ColumnReader::FloatColumnReader(reader) => read!(reader, f64::from),
        ColumnReader::Int64ColumnReader(reader) => read!(reader, |v: i64| v as f64),
        ColumnReader::Int32ColumnReader(reader) => read!(reader, f64::from),
        _ => Ok(None),
    }
}
