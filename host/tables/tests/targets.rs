//! Lists of targets in CSV and Parquet.

use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use parquet::basic::Compression;
use parquet::data_type::{DoubleType, FloatType, Int32Type};
use parquet::file::properties::WriterProperties;
use parquet::file::writer::SerializedFileWriter;
use parquet::schema::parser::parse_message_type;
use throw_tables::{TableError, TargetList, TargetRow};

fn file(name: &str) -> PathBuf {
    let folder = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join("targets");
    fs::create_dir_all(&folder).expect("folder");
    folder.join(name)
}

fn rows(list: &TargetList, from: u64) -> Vec<TargetRow> {
    list.rows_from(from).expect("opens").collect::<Result<_, _>>().expect("reads")
}

/// A Parquet list as others write it: several row groups, snappy, dictionaries, doubles beside floats and whole numbers.
fn write_parquet(path: &Path, groups: &[std::ops::Range<i32>]) {
    let schema = "message m { required double x_m; required float y_m; optional int32 z_m; }";
    let schema = Arc::new(parse_message_type(schema).expect("schema"));
    let properties = Arc::new(WriterProperties::builder().set_compression(Compression::SNAPPY).build());
    let mut writer =
        SerializedFileWriter::new(File::create(path).expect("file"), schema, properties).expect("writer");
    for rows in groups {
        let all: Vec<i32> = rows.clone().collect();
        let mut group = writer.next_row_group().expect("group");
        let x: Vec<f64> = all.iter().map(|v| f64::from(*v) * 0.1).collect();
        let mut column = group.next_column().expect("column").expect("x");
        column.typed::<DoubleType>().write_batch(&x, None, None).expect("writes");
        column.close().expect("closes");
        let y: Vec<f32> = all.iter().map(|v| *v as f32 * 0.5).collect();
        let mut column = group.next_column().expect("column").expect("y");
        column.typed::<FloatType>().write_batch(&y, None, None).expect("writes");
        column.close().expect("closes");
        // A negative number has no height.
        let there: Vec<i16> = all.iter().map(|v| i16::from(*v >= 0)).collect();
        let z: Vec<i32> = all.into_iter().filter(|v| *v >= 0).collect();
        let mut column = group.next_column().expect("column").expect("z");
        column.typed::<Int32Type>().write_batch(&z, Some(&there), None).expect("writes");
        column.close().expect("closes");
        group.close().expect("closes");
    }
    writer.close().expect("closes");
}

#[test]
fn a_parquet_list_has_its_rows_in_order_from_any_row_on() {
    let path = file("groups.parquet");
    write_parquet(&path, &[0..20_000, 20_000..20_001, 20_001..30_000]);
    let list = TargetList::open(&path).expect("opens");
    assert_eq!(list.len(), 30_000);
    let all = rows(&list, 0);
    for (number, row) in (0..).zip(&all) {
        let v = f64::from(number);
        assert_eq!(*row, TargetRow::point([v * 0.1, v * 0.5, v]));
    }
    for from in [1, 8191, 8192, 19_999, 20_000, 20_001, 29_999, 30_000] {
        assert_eq!(rows(&list, from), all[usize::try_from(from).unwrap()..], "from {from}");
    }
}

#[test]
fn an_empty_place_in_a_parquet_list_is_refused_with_its_column() {
    let path = file("empty-place.parquet");
    write_parquet(&path, std::slice::from_ref(&(-3..5)));
    let list = TargetList::open(&path).expect("opens");
    let refused =
        list.rows_from(0).expect("opens").collect::<Result<Vec<_>, TableError>>().expect_err("refused");
    assert!(refused.to_string().contains("column \"z_m\" has an empty place"), "{refused}");
}

#[test]
fn a_csv_list_has_the_rows_of_the_parquet_list_with_the_same_numbers() {
    let (csv, parquet) = (file("same.csv"), file("same.parquet"));
    write_parquet(&parquet, std::slice::from_ref(&(0..100)));
    // Another order of columns, a mark, blanks and a remark.
    let mut text = "\u{feff}z_m, x_m ,y_m\n# remark\n".to_owned();
    for v in 0..100 {
        text += &format!("{v},{} ,{}\n", f64::from(v) * 0.1, f64::from(v) * 0.5);
    }
    fs::write(&csv, text).expect("writes");
    let (csv, parquet) = (TargetList::open(&csv).expect("opens"), TargetList::open(&parquet).expect("opens"));
    assert_eq!(rows(&csv, 0), rows(&parquet, 0));
    assert_eq!(rows(&csv, 42), rows(&parquet, 42));
}

#[test]
fn an_opening_that_moves_has_all_its_numbers() {
    let path = file("opening.csv");
    let text =
        "x_m,y_m,z_m,nx,ny,nz,radius_m,incidence_max_deg,vx_m_s,vy_m_s,vz_m_s\n1,2,3,4,5,6,7,8,9,10,11\n";
    fs::write(&path, text).expect("writes");
    let expected = TargetRow {
        normal: Some([4.0, 5.0, 6.0]),
        radius_m: Some(7.0),
        incidence_max_deg: Some(8.0),
        velocity_m_s: Some([9.0, 10.0, 11.0]),
        ..TargetRow::point([1.0, 2.0, 3.0])
    };
    assert_eq!(rows(&TargetList::open(&path).expect("opens"), 0), [expected]);
}

#[test]
fn files_that_are_no_list_are_refused_with_row_and_column() {
    for (name, content, told) in [
        ("a.csv", "x_m,y_m\n1,2\n", "all or none are needed"),
        ("b.csv", "x_m,y_m,z_m,colour\n1,2,3,red\n", "\"colour\" is not known"),
        ("c.csv", "x_m,y_m,z_m\n1,2,-1\n1,nan,-1\n", "row 2, column \"y_m\""),
        ("d.csv", "x_m,y_m,z_m\n", "no target"),
        ("e.csv", "x_m,y_m,z_m,nx,ny,nz\n1,1,-1,0,0,1\n", "an opening needs"),
        ("f.csv", "x_m,y_m,z_m\n1,2,-1\n1,2\n", "fields"),
        ("g.parquet", "PAR1", "not a Parquet file"),
        ("h.parquet", "x_m,y_m,z_m\n1,2,-1\n", "not a Parquet file"),
    ] {
        let path = file(name);
        fs::write(&path, content).expect("writes");
        let refused = TargetList::open(&path).expect_err(name).to_string();
        assert!(refused.contains(told) && refused.contains(name), "{name}: {refused}");
    }
    assert!(
        TargetList::open(Path::new("/dev/zero")).expect_err("no file").to_string().contains("must be a file")
    );
}
