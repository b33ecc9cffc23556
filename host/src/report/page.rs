//! One self-contained HTML page: style, scripts and data inside, nothing fetched. Light or dark as the reader has it.

use std::fmt::Write as _;

use super::chart::{Chart, escape};

const STYLE: &str = include_str!("assets/style.css");
const DARK: &str = include_str!("assets/dark.css");
const NARROW: &str = include_str!("assets/narrow.css");
const PAPER_STYLE: &str = include_str!("assets/paper.css");
pub(super) const SCENE: &str = include_str!("assets/scene.js");
const CHARTS: &str = include_str!("assets/charts.js");
const PAPER: &str = include_str!("assets/paper.js");

/// How something is meant.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Tone {
    /// As it should be.
    Good,
    /// Worth a look.
    Warn,
    /// Not as it should be.
    Bad,
    /// Neither.
    Plain,
}

impl Tone {
    /// Class of the style.
    #[must_use]
    pub const fn class(self) -> &'static str {
        match self {
            Self::Good => "good",
            Self::Warn => "warn",
            Self::Bad => "bad",
            Self::Plain => "",
        }
    }
}

/// What the first lines of a page answer.
#[derive(Clone, Debug)]
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

/// A page under construction. Its answer is always shown; its parts are folded.
#[derive(Clone, Debug, Default)]
pub struct Page {
    title: String,
    body: String,
    scene: Option<String>,
    is_in_part: bool,
}

impl Page {
    /// Page with a heading, a line under it and its answer.
    #[must_use]
    pub fn new(title: &str, under: &str, answer: &Answer) -> Self {
        let class = if answer.tone == Tone::Plain { "plain" } else { answer.tone.class() };
        let body = format!(
            "<header><h1>{}</h1><p>{}</p></header><div class=\"card answer\"><p class=\"pill {class}\">{}</p><b>Why</b><p>{}</p><b>Next</b><p>{}</p></div>",
            escape(title),
            escape(under),
            escape(&answer.verdict),
            marked(&answer.why),
            marked(&answer.next)
        );
        Self { title: title.to_owned(), body, ..Self::default() }
    }

    /// Row of figures: value, unit, what it is.
    pub fn tiles(&mut self, tiles: &[(String, &str, String, Tone)]) {
        self.body += "<div class=\"tiles\">";
        for (value, unit, what, tone) in tiles {
            let _ = write!(
                self.body,
                "<div class=\"tile\"><b class=\"{}\">{}<small>{unit}</small></b><span>{}</span></div>",
                tone.class(),
                escape(value),
                escape(what).replace(" %", "\u{a0}%")
            );
        }
        self.body += "</div>";
    }

    /// A heading that is shown, with a sentence about what is to be seen.
    pub fn section(&mut self, heading: &str, about: &str) {
        self.end_part();
        let _ = write!(self.body, "<h2>{}</h2>{}", escape(heading), sentence(about));
    }

    /// A part that is folded, and open on paper.
    pub fn part(&mut self, heading: &str, about: &str) {
        self.fold("part", heading, about);
    }

    /// A part that is folded, and not on paper.
    pub fn detail(&mut self, heading: &str, about: &str) {
        self.fold("detail", heading, about);
    }

    fn fold(&mut self, class: &str, heading: &str, about: &str) {
        self.end_part();
        self.is_in_part = true;
        let _ = write!(
            self.body,
            "<details class=\"{class}\"><summary><h2>{}</h2></summary>{}",
            escape(heading),
            sentence(about)
        );
    }

    fn end_part(&mut self) {
        if std::mem::take(&mut self.is_in_part) {
            self.body += "</details>";
        }
    }

    /// Charts side by side, all of one scale.
    pub fn charts(&mut self, charts: &[Chart]) {
        self.body += "<div class=\"charts\">";
        for chart in charts {
            let _ = write!(self.body, "<figure class=\"card\">{}</figure>", chart.svg());
        }
        self.body += "</div>";
    }

    /// The picture in space with its controls, and something beside it. `data` is a JavaScript object.
    pub fn scene(&mut self, data: String, beside: &str) {
        let _ = write!(
            self.body,
            "<div class=\"scene\"><figure class=\"card\"><canvas id=\"scene\" aria-label=\"arm, hand path and flight\"></canvas><div class=\"bar\"><button id=\"play\">Play</button><select id=\"speed\" aria-label=\"speed\"><option value=\"1\">1 ×</option><option value=\"0.25\" selected>¼ ×</option><option value=\"0.05\">1/20 ×</option></select><input id=\"time\" type=\"range\" min=\"0\" max=\"1000\" value=\"0\" aria-label=\"time\"><output id=\"shown\"></output><button id=\"reset\">Reset</button><button id=\"top\">From above</button></div></figure>{beside}</div>"
        );
        self.scene = Some(data);
    }

    /// Table; the first column is text, cells have a tone.
    pub fn table(&mut self, head: &[&str], rows: &[Vec<(String, Tone)>]) {
        self.body += &table(head, rows);
    }

    /// Anything.
    pub fn html(&mut self, html: &str) {
        self.body += html;
    }

    /// Small print.
    pub fn note(&mut self, text: &str) {
        let _ = write!(self.body, "<p class=\"note\">{}</p>", marked(text));
    }

    /// The whole file.
    #[must_use]
    pub fn finish(mut self) -> String {
        self.end_part();
        // The charts listen first, then the scene sends the time.
        let scene = self
            .scene
            .map_or_else(String::new, |data| format!("<script>const scene={data};{SCENE}</script>"));
        let body = format!(
            "<body><main>{}<footer>Made by cubectl {}. Everything is inside this file: it needs no network.</footer></main><script>{CHARTS}{PAPER}</script>{scene}",
            self.body,
            env!("CARGO_PKG_VERSION")
        );
        document(&self.title, &body)
    }
}

/// A whole document; `body` begins with its tag.
pub(super) fn document(title: &str, body: &str) -> String {
    format!(
        "<!doctype html><html lang=\"en\"><head><meta charset=\"utf-8\"><meta name=\"viewport\" content=\"width=device-width\"><title>{}</title><style>{STYLE}</style><style id=\"dark\" media=\"(prefers-color-scheme:dark)\">{DARK}</style><style id=\"narrow\" media=\"(max-width:640px)\">{NARROW}</style><style id=\"paper\" media=\"print\">{PAPER_STYLE}</style></head>{body}</body></html>\n",
        escape(title)
    )
}

fn sentence(text: &str) -> String {
    if text.is_empty() { String::new() } else { format!("<p>{}</p>", marked(text)) }
}

/// Text for HTML; what stands between backticks is code.
fn marked(text: &str) -> String {
    let part = |(k, part)| if k % 2 == 1 { format!("<code>{part}</code>") } else { str::to_owned(part) };
    escape(text).split('`').enumerate().map(part).collect()
}

/// Table as HTML; the first column is text, cells have a tone.
#[must_use]
pub fn table(head: &[&str], rows: &[Vec<(String, Tone)>]) -> String {
    let mut o = "<div class=\"card scroll\"><table><thead><tr>".to_owned();
    for (i, name) in head.iter().enumerate() {
        let class = if i == 0 || is_text(rows, i) { " class=\"l\"" } else { "" };
        let _ = write!(o, "<th{class}>{}</th>", escape(name));
    }
    o += "</tr></thead><tbody>";
    for row in rows {
        o += "<tr>";
        for (i, (text, tone)) in row.iter().enumerate() {
            let side = if i == 0 || is_text(rows, i) { "l " } else { "" };
            let _ = write!(o, "<td class=\"{side}{}\">{}</td>", tone.class(), escape(text));
        }
        o += "</tr>";
    }
    o + "</tbody></table></div>"
}

/// A column whose cells are mostly no numbers stands to the left.
fn is_text(rows: &[Vec<(String, Tone)>], column: usize) -> bool {
    let cells = rows.iter().filter_map(|row| row.get(column)).filter(|cell| !cell.0.is_empty());
    let words = |text: &str| text.chars().filter(|c| c.is_alphabetic()).count() > 3;
    let (mut texts, mut all) = (0, 0);
    for cell in cells {
        all += 1;
        texts += usize::from(words(&cell.0));
    }
    2 * texts > all
}

/// Cell without a tone.
#[must_use]
pub fn cell(text: impl Into<String>) -> (String, Tone) {
    (text.into(), Tone::Plain)
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
    fn what_stands_between_backticks_is_code() {
        assert_eq!(
            marked("a < b: `throw --plan`, `c`"),
            "a &lt; b: <code>throw --plan</code>, <code>c</code>"
        );
        assert_eq!(marked("none"), "none");
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
