//! A page as data: its answer, its parts, and what stands in them. The scripts in `assets` make headings, tables, charts and pictures
//! of it in the browser. One self-contained HTML file: nothing is fetched. Light or dark as the reader has it.

use serde::Serialize;
use serde_json::Value;

use super::chart::Chart;
use super::reach::Map;
use super::scene::Space;
use super::timeline::Timeline;

const STYLE: &str = include_str!("assets/style.css");
const DARK: &str = include_str!("assets/dark.css");
const NARROW: &str = include_str!("assets/narrow.css");
const PAPER_STYLE: &str = include_str!("assets/paper.css");
const SCRIPTS: [&str; 4] = [
    include_str!("assets/page.js"),
    include_str!("assets/chart.js"),
    include_str!("assets/scene.js"),
    include_str!("assets/paper.js"),
];

/// How something is meant.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Tone {
    /// As it should be.
    Good,
    /// Worth a look.
    Warn,
    /// Not as it should be.
    Bad,
    /// Neither.
    #[serde(rename = "")]
    Plain,
}

impl Tone {
    /// Good if it is so, else bad.
    #[must_use]
    pub const fn of(is_good: bool) -> Self {
        if is_good { Self::Good } else { Self::Bad }
    }
}

/// What the first lines of a page answer.
#[derive(Clone, Debug, Serialize)]
pub struct Answer {
    /// What came of it.
    pub verdict: String,
    pub tone: Tone,
    pub why: String,
    pub next: String,
}

impl Answer {
    #[must_use]
    pub fn new(
        verdict: impl Into<String>,
        tone: Tone,
        why: impl Into<String>,
        next: impl Into<String>,
    ) -> Self {
        Self { verdict: verdict.into(), tone, why: why.into(), next: next.into() }
    }
}

/// A figure: value, unit, what it is.
#[derive(Clone, Debug, Serialize)]
pub struct Tile {
    value: String,
    unit: &'static str,
    what: String,
    tone: Tone,
}

impl Tile {
    #[must_use]
    #[expect(clippy::needless_pass_by_value, reason = "a text or a number, at hand or made on the way")]
    pub fn new(value: impl ToString, unit: &'static str, what: impl Into<String>) -> Self {
        Self { value: value.to_string(), unit, what: what.into(), tone: Tone::Plain }
    }

    #[must_use]
    pub fn toned(self, tone: Tone) -> Self {
        Self { tone, ..self }
    }
}

/// Text and tone of a cell of a table.
pub type Cell = (String, Tone);

/// The first column is text.
#[derive(Clone, Debug, Serialize)]
pub struct Table {
    head: Vec<String>,
    rows: Vec<Vec<Cell>>,
}

/// What stands in a part.
#[derive(Clone, Debug, Serialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum Block {
    Tiles(Vec<Tile>),
    Table(Table),
    Chart(Chart),
    /// Side by side, all of one scale.
    Charts(Vec<Chart>),
    /// Side by side.
    Beside(Vec<Block>),
    /// The picture in space with its controls, and a chart beside it.
    Space {
        scene: Box<Space>,
        beside: Option<Chart>,
    },
    Timeline(Timeline),
    Map(Map),
    Note(String),
    Pre(String),
    /// A line that may be divided.
    Command(String),
    /// A document as tables.
    Summary(Value),
    Folded {
        name: &'static str,
        block: Box<Block>,
    },
}

#[derive(Clone, Debug, Default, Serialize)]
struct Part {
    heading: String,
    about: String,
    /// Class of a part that is folded.
    fold: Option<&'static str>,
    blocks: Vec<Block>,
}

/// A page under construction. Its answer is always shown; its parts are folded.
#[derive(Clone, Debug, Serialize)]
pub struct Page {
    title: String,
    under: String,
    answer: Answer,
    parts: Vec<Part>,
    version: &'static str,
}

impl Page {
    /// Page with a heading, a line under it and its answer.
    #[must_use]
    pub fn new(title: &str, under: &str, answer: &Answer) -> Self {
        Self {
            title: title.to_owned(),
            under: under.to_owned(),
            answer: answer.clone(),
            parts: vec![Part::default()],
            version: env!("CARGO_PKG_VERSION"),
        }
    }

    pub(super) fn push(&mut self, block: Block) {
        self.parts.last_mut().expect("a page begins with a part").blocks.push(block);
    }

    /// Row of figures.
    pub fn tiles(&mut self, tiles: Vec<Tile>) {
        self.push(Block::Tiles(tiles));
    }

    /// A heading that is shown, with a sentence about what is to be seen.
    pub fn section(&mut self, heading: &str, about: &str) {
        self.begin(None, heading, about);
    }

    /// A part that is folded, and open on paper.
    pub fn part(&mut self, heading: &str, about: &str) {
        self.begin(Some("part"), heading, about);
    }

    /// A part that is folded, and not on paper.
    pub fn detail(&mut self, heading: &str, about: &str) {
        self.begin(Some("detail"), heading, about);
    }

    fn begin(&mut self, fold: Option<&'static str>, heading: &str, about: &str) {
        self.parts.push(Part { heading: heading.to_owned(), about: about.to_owned(), fold, blocks: vec![] });
    }

    /// Charts side by side, all of one scale.
    pub fn charts(&mut self, charts: impl IntoIterator<Item = Chart>) {
        self.push(Block::Charts(charts.into_iter().collect()));
    }

    /// The picture in space with its controls, and a chart beside it.
    pub fn scene(&mut self, scene: Space, beside: Option<Chart>) {
        self.push(Block::Space { scene: Box::new(scene), beside });
    }

    pub fn table(&mut self, head: &[&str], rows: Vec<Vec<Cell>>) {
        self.push(table(head, rows));
    }

    /// Text as it is.
    pub fn pre(&mut self, text: &str) {
        self.push(Block::Pre(text.to_owned()));
    }

    /// Small print.
    pub fn note(&mut self, text: &str) {
        self.push(Block::Note(text.to_owned()));
    }

    /// A document, folded.
    pub(super) fn summary(&mut self, summary: &Value) {
        let block = Box::new(Block::Summary(exact(summary)));
        self.push(Block::Folded { name: "Everything in summary.json", block });
    }

    /// The whole file.
    #[must_use]
    pub fn finish(self) -> String {
        document(&self.title, "", &self, "report(data);")
    }
}

/// A whole document: `data` for the scripts, then what `begins` them.
pub(super) fn document(title: &str, class: &str, data: &impl Serialize, begins: &str) -> String {
    // No text can end the element that holds it.
    let data = serde_json::to_string(data).expect("names of members are texts").replace('<', "\\u003c");
    format!(
        "<!doctype html><html lang=\"en\"><head><meta charset=\"utf-8\"><meta name=\"viewport\" content=\"width=device-width\"><title>{}</title><style>{STYLE}</style><style id=\"dark\" media=\"(prefers-color-scheme:dark)\">{DARK}</style><style id=\"narrow\" media=\"(max-width:640px)\">{NARROW}</style><style id=\"paper\" media=\"print\">{PAPER_STYLE}</style></head><body class=\"{class}\"><main><noscript>This page is drawn by JavaScript, which is switched off.</noscript></main><script type=\"application/json\" id=\"data\">{data}</script><script>{}{begins}</script></body></html>\n",
        escape(title),
        SCRIPTS.concat()
    )
}

fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

/// A document whose integers that a script cannot hold are texts.
fn exact(value: &Value) -> Value {
    const MOST: u64 = 1 << 53;
    match value {
        Value::Number(n)
            if n.as_u64().is_some_and(|n| n > MOST)
                || n.as_i64().is_some_and(|n| n.unsigned_abs() > MOST) =>
        {
            Value::String(n.to_string())
        }
        Value::Array(items) => items.iter().map(exact).collect(),
        Value::Object(map) => map.iter().map(|(key, value)| (key.clone(), exact(value))).collect(),
        other => other.clone(),
    }
}

pub(super) fn table(head: &[&str], rows: Vec<Vec<Cell>>) -> Block {
    Block::Table(Table { head: head.iter().map(|name| (*name).to_owned()).collect(), rows })
}

/// Cell without a tone.
#[must_use]
#[expect(clippy::needless_pass_by_value, reason = "a text or a number, at hand or made on the way")]
pub fn cell(text: impl ToString) -> Cell {
    (text.to_string(), Tone::Plain)
}

/// Cell of a number with so many digits, or of one that is not there.
#[must_use]
pub fn number(value: impl Into<Option<f64>>, digits: usize) -> Cell {
    cell(value.into().map_or("–".to_owned(), |value| format!("{value:.digits$}").replace('-', "−")))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Colour of a name in the style sheet, light or dark.
    fn colour(name: &str, is_dark: bool) -> [f64; 3] {
        let key = format!("--{name}:#");
        let rest = if is_dark { DARK } else { STYLE }.split(&key).nth(1).unwrap();
        let hex = &rest[..rest.find([';', '}']).unwrap()];
        let wide = if hex.len() == 3 { hex.chars().flat_map(|c| [c, c]).collect() } else { hex.to_owned() };
        [0, 2, 4].map(|i| f64::from(u8::from_str_radix(&wide[i..i + 2], 16).unwrap()) / 255.0)
    }

    /// Contrast by WCAG 2.2.
    fn contrast(one: [f64; 3], other: [f64; 3]) -> f64 {
        let linear = |c: f64| if c <= 0.04045 { c / 12.92 } else { ((c + 0.055) / 1.055).powf(2.4) };
        let luminance = |[r, g, b]: [f64; 3]| 0.2126 * linear(r) + 0.7152 * linear(g) + 0.0722 * linear(b);
        let (a, b) = (luminance(one), luminance(other));
        (a.max(b) + 0.05) / (a.min(b) + 0.05)
    }

    #[test]
    fn texts_from_files_cannot_leave_the_data_of_the_page() {
        let evil = "</script><script>alert(1)</script><!--<script>\u{2028}&\"'`";
        let mut page = Page::new(evil, evil, &Answer::new(evil, Tone::Bad, evil, evil));
        page.part(evil, evil);
        page.table(&[evil], vec![vec![cell(evil)]]);
        page.pre(evil);
        page.summary(&serde_json::json!({ evil: evil }));
        let html = page.finish();
        let (_, rest) = html.split_once("id=\"data\">").unwrap();
        let (data, rest) = rest.split_once("</script>").unwrap();
        assert!(!data.contains('<'), "{data}");
        let read: Value = serde_json::from_str(data).unwrap();
        assert_eq!(read["parts"][1]["blocks"][2]["folded"]["block"]["summary"][evil], evil);
        assert_eq!(read["answer"]["why"], evil);
        assert!(!rest.contains("alert"), "texts stand in the data alone");
        let title = html.split_once("<title>").unwrap().1.split_once("</title>").unwrap().0;
        assert!(!title.contains('<'), "{title}");
    }

    #[test]
    fn integers_that_a_script_cannot_hold_are_texts() {
        let exact = exact(&serde_json::json!({"seed": u64::MAX, "list": [1, -3, 0.5, 1_u64 << 60]}));
        assert_eq!(
            exact.to_string(),
            r#"{"list":[1,-3,0.5,"1152921504606846976"],"seed":"18446744073709551615"}"#
        );
    }

    #[test]
    fn every_text_has_a_contrast_of_4_5_in_light_and_in_dark() {
        for is_dark in [false, true] {
            let texts = ["ink", "soft", "accent", "good", "warn", "bad"];
            let on_paper = texts.iter().flat_map(|text| [(*text, "bg"), (*text, "card")]);
            let on_pills = ["good", "warn", "bad", "soft"].map(|pill| ("on", pill));
            for (text, ground) in on_paper.chain(on_pills) {
                let is = contrast(colour(text, is_dark), colour(ground, is_dark));
                assert!(is >= 4.5, "{text} on {ground}, dark {is_dark}: {is:.2}");
            }
        }
        assert!((contrast([0.0; 3], [1.0; 3]) - 21.0).abs() < 1e-9);
    }
}
