//! Documents out of a byte stream.

use proptest::prelude::*;
use rsi_protocol::{Framer, MAX_READ_BYTES, StreamItem};

const A: &str = r#"<Rob Type="KUKA"><AIPos A1="0.0" A2="-90.0"/><IPOC>1</IPOC></Rob>"#;
const B: &str = "<?xml version='1.0'?>\r\n<!-- <Rob> -> -->\n<Sen Type='a>b'><Sensor x=\"/\" /><Dat><IPOC>2</IPOC></Dat></Sen>";

fn cut(stream: &[u8], size: usize) -> Vec<StreamItem> {
    let mut framer = Framer::new();
    stream.chunks(size.max(1)).flat_map(|chunk| framer.push(chunk)).collect()
}

fn documents(items: &[StreamItem]) -> Vec<String> {
    let text = |item: &StreamItem| match item {
        StreamItem::Document(bytes) => Some(String::from_utf8_lossy(bytes).into_owned()),
        StreamItem::Dropped(_) => None,
    };
    items.iter().filter_map(text).collect()
}

fn dropped(items: &[StreamItem]) -> usize {
    items.iter().map(|item| if let StreamItem::Dropped(n) = item { *n } else { 0 }).sum()
}

#[test]
fn documents_back_to_back_come_out_whole_in_pieces_of_any_size() {
    let stream = format!("{A}\n\n{B}\0{A}{A}<Rob/>{A}");
    for size in 1..stream.len() {
        let items = cut(stream.as_bytes(), size);
        assert_eq!(documents(&items), [A, B, A, A, "<Rob/>", A], "pieces of {size}");
        assert_eq!(dropped(&items), 0);
    }
}

#[test]
fn document_torn_anywhere_costs_no_other_document() {
    for at in 1..A.len() {
        let stream = format!("{A}{}{A}{B}", &A[..at]);
        let items = cut(stream.as_bytes(), 7);
        assert_eq!(documents(&items), [A, A, B], "torn after {at} bytes");
        assert_eq!(dropped(&items), at);
    }
}

#[test]
fn rest_of_a_torn_document_costs_no_whole_document() {
    for at in 1..A.len() {
        let items = cut(format!("{}{A}{B}", &A[at..]).as_bytes(), 1000);
        let whole = documents(&items);
        // The rest may contain whole elements; they are refused later because of their root.
        assert!(whole.ends_with(&[A.to_owned(), B.to_owned()]), "from byte {at}: {whole:?}");
        assert!(whole.iter().filter(|text| text.starts_with("<Rob")).count() == 1, "{whole:?}");
    }
}

#[test]
fn document_that_never_ends_is_dropped_and_the_next_is_found() {
    let mut framer = Framer::new();
    let endless = format!("<Rob>{}", "x".repeat(10 * MAX_READ_BYTES));
    assert_eq!(documents(&framer.push(endless.as_bytes())).len(), 0);
    assert!(framer.pending() <= MAX_READ_BYTES);
    assert_eq!(documents(&framer.push(format!("</Rob>{A}").as_bytes())), [A]);
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 64, ..ProptestConfig::default() })]

    #[test]
    fn every_byte_is_in_a_document_or_dropped_or_pending_or_blank(
        bytes in prop::collection::vec(prop_oneof![
            any::<u8>(),
            prop::sample::select(b"<>/?!-\"' \0RobSenx".to_vec()),
        ], 0..6000),
        size in 1..700_usize,
    ) {
        let mut framer = Framer::new();
        let items: Vec<StreamItem> = bytes.chunks(size).flat_map(|chunk| framer.push(chunk)).collect();
        let in_documents: usize = items
            .iter()
            .map(|item| if let StreamItem::Document(d) = item { d.len() } else { 0 })
            .sum();
        let counted = in_documents + dropped(&items) + framer.pending();
        let blank = bytes.iter().filter(|byte| byte.is_ascii_whitespace() || **byte == 0).count();
        prop_assert!(counted <= bytes.len() && bytes.len() <= counted + blank, "{counted} of {} bytes", bytes.len());
        prop_assert!(framer.pending() <= MAX_READ_BYTES);
    }

    #[test]
    fn size_of_the_pieces_changes_nothing(
        bytes in prop::collection::vec(prop::sample::select(b"<>/?!-\"' RobSen".to_vec()), 0..400),
        size in 1..50_usize,
    ) {
        let (whole, pieces) = (cut(&bytes, bytes.len()), cut(&bytes, size));
        prop_assert_eq!(documents(&whole), documents(&pieces));
        prop_assert_eq!(dropped(&whole), dropped(&pieces));
    }
}
