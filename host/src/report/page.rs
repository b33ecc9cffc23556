//! One self-contained HTML page: style, scripts and data inside, nothing fetched. Light or dark as the reader has it.

use std::fmt::Write as _;

use super::chart::{Chart, escape};

pub(super) const STYLE: &str = include_str!("assets/style.css");
pub(super) const SCENE: &str = include_str!("assets/scene.js");
const CHARTS: &str = include_str!("assets/charts.js");

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

/// A page under construction.
#[derive(Clone, Debug, Default)]
pub struct Page {
    title: String,
    body: String,
    scene: Option<String>,
}

impl Page {
    /// Page with a heading, a line under it and a verdict beside it.
    #[must_use]
    pub fn new(title: &str, under: &str, verdict: Option<(&str, Tone)>) -> Self {
        let pill = verdict.map_or_else(String::new, |(text, tone)| {
            format!("<span class=\"pill {}\">{}</span>", tone.class(), escape(text))
        });
        let body = format!("<header><h1>{}{pill}</h1><p>{}</p></header>", escape(title), escape(under));
        Self { title: title.to_owned(), body, scene: None }
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
                escape(what)
            );
        }
        self.body += "</div>";
    }

    /// Heading of a section with a sentence about what is to be seen.
    pub fn section(&mut self, heading: &str, about: &str) {
        let _ = write!(self.body, "<h2>{}</h2><p>{}</p>", escape(heading), escape(about));
    }

    /// Charts side by side; small ones three in a row.
    pub fn charts(&mut self, charts: &[Chart]) {
        let class = if charts.iter().all(|chart| chart.small) { "three" } else { "two" };
        let _ = write!(self.body, "<div class=\"{class}\">");
        for chart in charts {
            let _ = write!(self.body, "<figure class=\"card\">{}</figure>", chart.svg());
        }
        self.body += "</div>";
    }

    /// Charts that are folded away.
    pub fn folded(&mut self, heading: &str, charts: &[Chart]) {
        let _ = write!(self.body, "<details><summary>{}</summary>", escape(heading));
        self.charts(charts);
        self.body += "</details>";
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
        let _ = write!(self.body, "<p class=\"note\">{}</p>", escape(text));
    }

    /// The whole file.
    #[must_use]
    pub fn finish(self) -> String {
        let scripts = match self.scene {
            // The charts listen first, then the scene tells the time.
            Some(data) => format!("<script>{CHARTS}</script><script>const scene={data};{SCENE}</script>"),
            None => format!("<script>{CHARTS}</script>"),
        };
        format!(
            "<!doctype html><html lang=\"en\"><head><meta charset=\"utf-8\"><meta name=\"viewport\" content=\"width=device-width\"><title>{}</title><style>{STYLE}</style></head><body><main>{}<footer>Made by cubectl {}. Everything is inside this file: it needs no network.</footer></main>{scripts}</body></html>\n",
            escape(&self.title),
            self.body,
            env!("CARGO_PKG_VERSION")
        )
    }
}

/// Table as HTML; the first column is text, cells have a tone.
#[must_use]
pub fn table(head: &[&str], rows: &[Vec<(String, Tone)>]) -> String {
    let mut o = "<div class=\"card scroll\"><table><tr>".to_owned();
    for (i, name) in head.iter().enumerate() {
        let class = if i == 0 || is_text(rows, i) { " class=\"l\"" } else { "" };
        let _ = write!(o, "<th{class}>{}</th>", escape(name));
    }
    o += "</tr>";
    for row in rows {
        o += "<tr>";
        for (i, (text, tone)) in row.iter().enumerate() {
            let side = if i == 0 || is_text(rows, i) { "l " } else { "" };
            let _ = write!(o, "<td class=\"{side}{}\">{}</td>", tone.class(), escape(text));
        }
        o += "</tr>";
    }
    o + "</table></div>"
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
