//! One part file: the rows of a shard as Parquet.
//!
//! The columns are flat. Numbers are doubles without compression and without dictionaries, the name of the writer is fixed, and row
//! groups end at row numbers of the shard: the bytes follow from the rows.

use std::fs::File;
use std::io::Write;
use std::path::Path;
use std::sync::Arc;

use parquet::basic::{LogicalType, Repetition, Type as Physical};
use parquet::column::reader::ColumnReader;
use parquet::data_type::{ByteArray, ByteArrayType, DoubleType, Int64Type};
use parquet::errors::ParquetError;
use parquet::file::metadata::KeyValue;
use parquet::file::properties::WriterProperties;
use parquet::file::reader::{FileReader, SerializedFileReader};
use parquet::file::writer::SerializedFileWriter;
use parquet::schema::types::Type;

use crate::error::{TableError, system};
use crate::row::{Row, Thrown};

/// Rows of a row group, and most rows that are held in memory.
pub const GROUP_ROWS: usize = 8192;
/// Key of the file's metadata that says what the part is of.
const STUDY_KEY: &str = "cubecell.study";
/// Name of the writer in the file. It has no version of the program: the study has.
const CREATED_BY: &str = "cubecell";

/// A number of a row.
type Number = Box<dyn Fn(&Row) -> Option<f64> + Send>;

/// What a column holds of a row.
enum Kind {
    Whole(fn(&Row) -> Option<u64>),
    Double(Number),
    Text(fn(&Row) -> &str),
}

struct Column {
    name: String,
    optional: bool,
    kind: Kind,
}

/// A number of the throw; none for a row without one.
fn of_throw(name: impl Into<String>, value: impl Fn(&Thrown) -> Option<f64> + Send + 'static) -> Column {
    let value = move |row: &Row| row.throw.as_ref().and_then(&value);
    Column { name: name.into(), optional: true, kind: Kind::Double(Box::new(value)) }
}

/// All columns for an arm of `joints` joints, in order.
fn columns(joints: usize) -> Vec<Column> {
    let required = |name: &str, kind| Column { name: name.to_owned(), optional: false, kind };
    let optional =
        |name: &str, value| Column { name: name.to_owned(), optional: true, kind: Kind::Whole(value) };
    let mut all = vec![required("row", Kind::Whole(|row| Some(row.number)))];
    for (axis, name) in ["x_m", "y_m", "z_m"].into_iter().enumerate() {
        all.push(required(name, Kind::Double(Box::new(move |row| Some(row.target_m[axis])))));
    }
    all.push(required("outcome", Kind::Text(|row| row.outcome.name())));
    all.extend([
        of_throw("objective", |t| Some(t.objective)),
        of_throw("release_s", |t| Some(t.release_s)),
        of_throw("duration_s", |t| Some(t.duration_s)),
        of_throw("flight_s", |t| Some(t.flight_s)),
        of_throw("speed_m_s", |t| Some(t.velocity_m_s.iter().map(|v| v * v).sum::<f64>().sqrt())),
        of_throw("spread_m", |t| Some(t.spread_m)),
        of_throw("hit_probability", |t| t.hit_probability),
    ]);
    for (axis, name) in ["x", "y", "z"].into_iter().enumerate() {
        all.push(of_throw(format!("release_{name}_m"), move |t| Some(t.position_m[axis])));
    }
    for (axis, name) in ["x", "y", "z"].into_iter().enumerate() {
        all.push(of_throw(format!("release_v{name}_m_s"), move |t| Some(t.velocity_m_s[axis])));
    }
    for joint in 0..joints {
        all.push(of_throw(format!("release_q{}_rad", joint + 1), move |t| t.q_rad.get(joint).copied()));
    }
    for joint in 0..joints {
        all.push(of_throw(format!("release_qd{}_rad_s", joint + 1), move |t| t.qd_rad_s.get(joint).copied()));
    }
    for joint in 0..joints {
        all.push(of_throw(format!("release_qdd{}_rad_s2", joint + 1), move |t| {
            t.qdd_rad_s2.get(joint).copied()
        }));
    }
    all.extend([
        optional("plan_crc32", |row| row.throw.as_ref().map(|t| u64::from(t.plan_crc32))),
        optional("draws_landed", |row| row.throw.as_ref()?.landings.map(|l| l.landed)),
        optional("draws_hit", |row| row.throw.as_ref()?.landings?.hits),
        of_throw("draws_miss_rms_m", |t| t.landings?.miss_rms_m),
        of_throw("draws_miss_max_m", |t| t.landings?.miss_max_m),
        required("note", Kind::Text(|row| &row.note)),
    ]);
    all
}

fn schema(columns: &[Column]) -> Result<Type, ParquetError> {
    let fields = columns.iter().map(|column| {
        let physical = match column.kind {
            Kind::Whole(_) => Physical::INT64,
            Kind::Double(_) => Physical::DOUBLE,
            Kind::Text(_) => Physical::BYTE_ARRAY,
        };
        let text = matches!(column.kind, Kind::Text(_)).then_some(LogicalType::String);
        let repetition = if column.optional { Repetition::OPTIONAL } else { Repetition::REQUIRED };
        let field = Type::primitive_type_builder(&column.name, physical)
            .with_repetition(repetition)
            .with_logical_type(text)
            .build()?;
        Ok(Arc::new(field))
    });
    Type::group_type_builder("throws").with_fields(fields.collect::<Result<_, ParquetError>>()?).build()
}

/// Writes the rows of a part.
pub struct PartWriter<W: Write + Send> {
    columns: Vec<Column>,
    writer: SerializedFileWriter<W>,
}

impl<W: Write + Send> PartWriter<W> {
    /// Begins a part of the study with this text, for an arm of `joints` joints.
    ///
    /// # Errors
    /// Writing fails.
    pub fn new(out: W, joints: usize, study: &str) -> std::io::Result<Self> {
        let columns = columns(joints);
        let properties = WriterProperties::builder()
            .set_created_by(CREATED_BY.to_owned())
            .set_dictionary_enabled(false)
            .set_key_value_metadata(Some(vec![KeyValue::new(STUDY_KEY.to_owned(), study.to_owned())]))
            .build();
        let schema = schema(&columns).map_err(system)?;
        let writer =
            SerializedFileWriter::new(out, Arc::new(schema), Arc::new(properties)).map_err(system)?;
        Ok(Self { columns, writer })
    }

    /// Writes rows as one row group; call it with [`GROUP_ROWS`] rows, and fewer for the last ones.
    ///
    /// # Errors
    /// Writing fails.
    pub fn write(&mut self, rows: &[Row]) -> std::io::Result<()> {
        let write = |columns: &[Column], writer: &mut SerializedFileWriter<W>| {
            let mut group = writer.next_row_group()?;
            let mut columns = columns.iter();
            while let (Some(mut out), Some(column)) = (group.next_column()?, columns.next()) {
                match &column.kind {
                    Kind::Text(text) => {
                        let values: Vec<ByteArray> = rows.iter().map(|row| text(row).into()).collect();
                        out.typed::<ByteArrayType>().write_batch(&values, None, None)?;
                    }
                    Kind::Whole(of) => {
                        let whole = |row: &Row| of(row).map(|v| i64::try_from(v).unwrap_or(i64::MAX));
                        let (values, there) = optional(rows, whole);
                        let there = column.optional.then_some(&there[..]);
                        out.typed::<Int64Type>().write_batch(&values, there, None)?;
                    }
                    Kind::Double(of) => {
                        let (values, there) = optional(rows, of);
                        let there = column.optional.then_some(&there[..]);
                        out.typed::<DoubleType>().write_batch(&values, there, None)?;
                    }
                }
                out.close()?;
            }
            group.close()
        };
        write(&self.columns, &mut self.writer).map(drop).map_err(system)
    }

    /// Writes the end of the file.
    ///
    /// # Errors
    /// Writing fails.
    pub fn finish(self) -> std::io::Result<W> {
        self.writer.into_inner().map_err(system)
    }
}

/// The values that are there, and for each row whether its value is.
fn optional<T>(rows: &[Row], of: impl Fn(&Row) -> Option<T>) -> (Vec<T>, Vec<i16>) {
    let all: Vec<Option<T>> = rows.iter().map(of).collect();
    let there = all.iter().map(|value| i16::from(value.is_some())).collect();
    (all.into_iter().flatten().collect(), there)
}

/// The end of a part file: what it is of and how many rows it has.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Ending {
    /// The text of the study.
    pub study: String,
    pub rows: u64,
}

/// Reads the end of a part file; `None` for a file that is not whole or of something else.
///
/// # Errors
/// The file is there and cannot be opened.
pub fn ending(path: &Path) -> Result<Option<Ending>, TableError> {
    let file = match File::open(path) {
        Ok(file) => file,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(None),
        Err(error) => return Err(TableError::reading(path)(error)),
    };
    let Ok(reader) = SerializedFileReader::new(file) else { return Ok(None) };
    let metadata = reader.metadata().file_metadata();
    let study = metadata.key_value_metadata().into_iter().flatten().find(|pair| pair.key == STUDY_KEY);
    let study = study.and_then(|pair| pair.value.clone());
    Ok(study.map(|study| Ending { study, rows: u64::try_from(metadata.num_rows()).unwrap_or(0) }))
}

/// Values of a column of a row group; `None` for a row without one.
pub(crate) enum Values {
    Doubles(Vec<Option<f64>>),
    Texts(Vec<String>),
}

/// Reads the named columns of a part, one row group after the other.
///
/// # Errors
/// The file cannot be read, or a column is missing.
pub(crate) fn read_columns<const N: usize>(
    path: &Path,
    names: [&str; N],
    mut take: impl FnMut([Values; N]),
) -> Result<(), TableError> {
    let fail = |error: ParquetError| TableError::reading(path)(system(error));
    let file = File::open(path).map_err(TableError::reading(path))?;
    let reader = SerializedFileReader::new(file).map_err(fail)?;
    let found = reader.metadata().file_metadata().schema_descr().columns().to_vec();
    for group in 0..reader.num_row_groups() {
        let group = reader.get_row_group(group).map_err(fail)?;
        let rows = usize::try_from(group.metadata().num_rows()).unwrap_or(0);
        let mut values = Vec::with_capacity(N);
        for name in names {
            let at = found.iter().position(|column| column.name() == name);
            let column = at.ok_or_else(|| {
                TableError::Refused(format!("{}: column \"{name}\" is missing", path.display()))
            })?;
            values.push(read_column(group.get_column_reader(column).map_err(fail)?, rows).map_err(fail)?);
        }
        // One for each name.
        if let Ok(values) = values.try_into() {
            take(values);
        }
    }
    Ok(())
}

fn read_column(reader: ColumnReader, rows: usize) -> Result<Values, ParquetError> {
    // Columns that must be there have no levels.
    let spread = |values: Vec<f64>, there: &[i16]| {
        let mut values = values.into_iter();
        if there.is_empty() {
            return values.map(Some).collect();
        }
        there.iter().map(|there| if *there == 1 { values.next() } else { None }).collect()
    };
    let mut there = Vec::new();
    match reader {
        ColumnReader::DoubleColumnReader(mut reader) => {
            let mut values = Vec::new();
            reader.read_records(rows, Some(&mut there), None, &mut values)?;
            Ok(Values::Doubles(spread(values, &there)))
        }
        ColumnReader::Int64ColumnReader(mut reader) => {
            let mut values = Vec::new();
            reader.read_records(rows, Some(&mut there), None, &mut values)?;
            Ok(Values::Doubles(spread(values.into_iter().map(|v| v as f64).collect(), &there)))
        }
        ColumnReader::ByteArrayColumnReader(mut reader) => {
            let mut values = Vec::new();
            reader.read_records(rows, Some(&mut there), None, &mut values)?;
            Ok(Values::Texts(values.iter().map(|v| String::from_utf8_lossy(v.data()).into_owned()).collect()))
        }
        _ => Err(ParquetError::General("a column of an unexpected type".to_owned())),
    }
}
