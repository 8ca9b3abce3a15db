//! Pages of text, tables and figures as HTML that needs no other file and no script.

use std::fmt::Write;

use super::figure::{Figure, FigureLevel, StatusWord};
use super::svg::{panel_svg, style, swatch};
use crate::language::Language;
use armwatch_model::text::xml;

/// A page.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Page {
    /// Title of the page.
    pub title: String,
    /// A line below the title.
    pub subtitle: String,
    /// Parts, in order; in print, the first part has a separate sheet.
    pub sections: Vec<PageSection>,
    /// Its language.
    pub language: Language,
}

/// A part of a page.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct PageSection {
    /// Heading of the part.
    pub heading: String,
    /// Its contents.
    pub blocks: Vec<PageBlock>,
}

/// An element of a part.
#[derive(Debug, Clone, PartialEq)]
pub enum PageBlock {
    /// A paragraph.
    Text(String),
    /// A remark in small letters.
    Note(String),
    /// Facts, each with its name.
    Facts(Vec<(String, String)>),
    /// The most important findings, each with a colour.
    Findings(Vec<PageFinding>),
    /// Rows of numbers or words.
    Table(PageTable),
    /// A picture.
    Figure(Box<Figure>),
}

/// An important finding.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PageFinding {
    /// Its status.
    pub standing: StatusWord,
    /// Its title.
    pub title: String,
    /// Its text, one string per paragraph.
    pub words: Vec<String>,
}

/// A table of a page.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct PageTable {
    /// Caption of the table.
    pub caption: String,
    /// Names of its columns, with units.
    pub header: Vec<String>,
    /// Rows, with one cell per column.
    pub rows: Vec<Vec<TableCell>>,
}

/// A cell of a table.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum TableCell {
    /// Text, aligned left.
    Words(String),
    /// A number, aligned right.
    Number(String),
    /// A status.
    Standing(StatusWord),
}

impl Page {
    /// The page as HTML, which is also well-formed XML. It follows the reader's light or dark setting and prints on A4.
    pub fn html(&self) -> String {
        let mut body = format!("<header>\n<h1>{}</h1>\n", xml(&self.title));
        if !self.subtitle.is_empty() {
            let _ = writeln!(body, "<p class=\"soft\">{}</p>", xml(&self.subtitle));
        }
        body.push_str("</header>\n<main>\n");
        for section in &self.sections {
            let _ = writeln!(body, "<section>\n<h2>{}</h2>", xml(&section.heading));
            section.blocks.iter().for_each(|block| write_block(&mut body, block));
            body.push_str("</section>\n");
        }
        body.push_str("</main>\n");
        document(&self.title, self.language, &body)
    }
}

impl Figure {
    /// The picture as a self-contained HTML page. On narrow screens its panels are below each other.
    pub fn html(&self) -> String {
        let mut body = format!("<header>\n<h1>{}</h1>\n</header>\n<main>\n", xml(&self.title));
        write_figure(&mut body, self, &self.subtitle);
        body.push_str("</main>\n");
        document(&self.title, Language::English, &body)
    }
}

fn document(title: &str, language: Language, body: &str) -> String {
    format!(
        "<!DOCTYPE html>\n<html lang=\"{}\">\n<head>\n<meta charset=\"utf-8\"/>\n<meta name=\"viewport\" \
         content=\"width=device-width, initial-scale=1\"/>\n<title>{}</title>\n<style>\n{PAGE_STYLE}{}</style>\n</head>\n\
         <body>\n{body}</body>\n</html>\n",
        language.code(),
        xml(title),
        style()
    )
}

fn write_block(body: &mut String, block: &PageBlock) {
    match block {
        PageBlock::Text(words) => {
            let _ = writeln!(body, "<p>{}</p>", xml(words));
        }
        PageBlock::Note(words) => {
            let _ = writeln!(body, "<p class=\"soft note\">{}</p>", xml(words));
        }
        PageBlock::Facts(facts) => {
            body.push_str("<dl>\n");
            for (name, words) in facts {
                let _ = writeln!(body, "<div><dt>{}</dt><dd>{}</dd></div>", xml(name), xml(words));
            }
            body.push_str("</dl>\n");
        }
        PageBlock::Findings(findings) => {
            body.push_str("<ul class=\"findings\">\n");
            for finding in findings {
                let class = finding.standing.level.class();
                let (title, word) = (xml(&finding.title), xml(&finding.standing.word));
                let _ = writeln!(body, "<li class=\"{class}\"><strong>{title}</strong> <em>{word}</em>");
                for words in &finding.words {
                    let _ = writeln!(body, "<p>{}</p>", xml(words));
                }
                body.push_str("</li>\n");
            }
            body.push_str("</ul>\n");
        }
        PageBlock::Table(table) => write_table(body, table),
        PageBlock::Figure(figure) => write_figure(body, figure, &figure.subtitle),
    }
}

fn write_table(body: &mut String, table: &PageTable) {
    let caption = xml(&table.caption);
    let _ = writeln!(
        body,
        "<div class=\"scroll\" tabindex=\"0\" role=\"region\" aria-label=\"{caption}\">\n<table>\n<caption>{caption}</caption>\n\
         <thead>\n<tr>"
    );
    let is_number =
        |column: usize| table.rows.iter().any(|row| matches!(row.get(column), Some(TableCell::Number(_))));
    for (column, name) in table.header.iter().enumerate() {
        let class = if is_number(column) { " class=\"number\"" } else { "" };
        let _ = write!(body, "<th scope=\"col\"{class}>{}</th>", xml(name));
    }
    body.push_str("</tr>\n</thead>\n<tbody>\n");
    for row in &table.rows {
        body.push_str("<tr>");
        for cell in row {
            let _ = match cell {
                TableCell::Words(words) => write!(body, "<td>{}</td>", xml(words)),
                TableCell::Number(figure) => write!(body, "<td class=\"number\">{}</td>", xml(figure)),
                TableCell::Standing(of) => {
                    write!(body, "<td><em class=\"{}\">{}</em></td>", of.level.class(), xml(&of.word))
                }
            };
        }
        body.push_str("</tr>\n");
    }
    body.push_str("</tbody>\n</table>\n</div>\n");
}

fn write_figure(body: &mut String, figure: &Figure, words: &str) {
    let across = if figure.across() > 1 { "" } else { " wide" };
    let _ = writeln!(body, "<figure>\n<figcaption><strong>{}</strong>", xml(&figure.title));
    if !words.is_empty() {
        let _ = writeln!(body, "<p class=\"soft\">{}</p>", xml(words));
    }
    if !figure.legend.is_empty() {
        body.push_str("<ul class=\"legend\">\n");
        for key in &figure.legend {
            let _ = writeln!(
                body,
                "<li><svg class=\"plot\" width=\"30\" height=\"16\" viewBox=\"-2 -8 30 16\" aria-hidden=\"true\">{}</svg>{}</li>",
                swatch(key.look).trim_end(),
                xml(&key.label)
            );
        }
        body.push_str("</ul>\n");
    }
    let _ = writeln!(body, "</figcaption>\n<div class=\"panels{across}\">");
    for panel in &figure.panels {
        let _ = writeln!(body, "<div class=\"panel\">{}</div>", panel_svg(figure, panel));
    }
    if figure.panels.is_empty() {
        body.push_str("<p class=\"soft\">no data</p>\n");
    }
    body.push_str("</div>\n</figure>\n");
}

impl StatusWord {
    /// A word with its colour.
    pub fn new(word: impl Into<String>, level: FigureLevel) -> Self {
        Self { word: word.into(), level }
    }
}

/// Style of a page for light and dark screens and for print.
const PAGE_STYLE: &str = "\
:root { color-scheme: light dark; --page: #ffffff; --text: #22262c; --soft: #5c6470; --line: #d9dde3; --head: #f3f5f8;
  --usual: #1d7a4c; --warning: #9a5b00; --critical: #b3121b; --unknown: #5c6470 }
body { margin: 0 auto; padding: 1.5rem 1rem 3rem; max-width: 70rem; background: var(--page); color: var(--text);
  font: 15px/1.5 system-ui, 'Segoe UI', 'DejaVu Sans', Helvetica, Arial, sans-serif }
h1 { font-size: 1.7rem; line-height: 1.2; margin: 0 0 .3rem; overflow-wrap: anywhere }
h2 { font-size: 1.25rem; margin: 2.2rem 0 .6rem; padding-top: .8rem; border-top: 1px solid var(--line) }
p { margin: .4rem 0; max-width: 52rem; overflow-wrap: anywhere }
header p { margin: 0 }
.soft { color: var(--soft) }
.note { font-size: .875rem }
dl { display: grid; grid-template-columns: repeat(auto-fit, minmax(min(100%, 16rem), 1fr)); gap: .5rem 1.5rem; margin: .6rem 0 }
dt { font-size: .8rem; color: var(--soft) }
dd { margin: 0; overflow-wrap: anywhere }
em { font-style: normal; font-weight: 600 }
em.usual, .findings .usual em { color: var(--usual) }
em.warning, .findings .warning em { color: var(--warning) }
em.critical, .findings .critical em { color: var(--critical) }
em.unknown, .findings .unknown em { color: var(--unknown) }
.findings { list-style: none; margin: .6rem 0; padding: 0; display: grid; gap: .6rem }
.findings li { border-left: 4px solid var(--line); padding: .15rem 0 .15rem .8rem; break-inside: avoid }
.findings .usual { border-color: var(--usual) } .findings .warning { border-color: var(--warning) }
.findings .critical { border-color: var(--critical) } .findings .unknown { border-color: var(--unknown) }
.findings p { margin: .1rem 0 }
.scroll { overflow-x: auto; margin: .8rem 0 }
table { border-collapse: collapse; font-size: .875rem; font-variant-numeric: tabular-nums }
caption { text-align: left; font-weight: 600; padding: .3rem 0 }
th, td { padding: .25rem .7rem .25rem 0; text-align: left; vertical-align: top; border-bottom: 1px solid var(--line) }
th { color: var(--soft); font-weight: 600; border-bottom-width: 2px; vertical-align: bottom }
.number { text-align: right; white-space: nowrap }
figure { margin: 1rem 0 1.6rem }
figcaption p { font-size: .875rem }
.legend { list-style: none; display: flex; flex-wrap: wrap; gap: .2rem 1.1rem; margin: .4rem 0; padding: 0; font-size: .875rem }
.legend li { display: flex; align-items: center; gap: .4rem }
.panels { display: grid; grid-template-columns: repeat(auto-fit, minmax(min(100%, 24rem), 1fr)); gap: .4rem .8rem }
.panels.wide { grid-template-columns: 1fr }
.panels .plot { display: block; width: 100%; height: auto }
.wide .panel { overflow-x: auto } .wide .plot { min-width: 40rem }
@media screen and (prefers-color-scheme: dark) { :root { --page: #12151a; --text: #e3e6eb; --soft: #a7b0bd; --line: #323944;
  --head: #1c2129; --usual: #55d08d; --warning: #f5b94d; --critical: #ff7b72; --unknown: #a7b0bd } }
@media print { @page { size: A4; margin: 14mm 13mm } :root { color-scheme: light }
  html { font-size: 10.5px } body { padding: 0; max-width: none; font-size: 1rem } h1 { font-size: 2rem } h2 { break-after: avoid }
  .panels { grid-template-columns: 1fr 1fr } .panels.wide { grid-template-columns: 1fr } .wide .plot { min-width: 0 }
  .panel, tr, figcaption { break-inside: avoid } figcaption, caption { break-after: avoid } .scroll, .wide .panel { overflow: visible }
  section:first-child { break-after: page } section:first-child h2 { border-top: 0 } table { font-size: .85rem } th, td { padding-right: .5rem }
  * { print-color-adjust: exact; -webkit-print-color-adjust: exact } }
";

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::figure::{Key, Look, Mark, Panel, Series};

    fn figure(panels: usize) -> Figure {
        let series =
            Series { name: "a & b".into(), colour: 0, mark: Mark::LineWithDots, points: vec![[0.0, 1.0]] };
        let panel = Panel { title: "<one>".into(), series: vec![series], ..Panel::default() };
        Figure {
            title: "fig <1>".into(),
            subtitle: "\"what\" & which".into(),
            legend: vec![Key { label: "a < b".into(), look: Look::Series(0, Mark::LineWithDots) }],
            panels: vec![panel; panels],
            columns: 2,
        }
    }

    fn elements(html: &str) -> Vec<String> {
        let events = xml::EventReader::from_str(html).into_iter();
        events
            .map(|event| event.unwrap_or_else(|error| panic!("{error}\n{html}")))
            .filter_map(|event| match event {
                xml::reader::XmlEvent::StartElement { name, .. } => Some(name.local_name),
                _ => None,
            })
            .collect()
    }

    #[test]
    fn every_block_is_well_formed_and_its_words_are_no_markup() {
        let words = "<script>alert(1)</script> & \"more\"".to_string();
        let standing = StatusWord::new(words.clone(), FigureLevel::Critical);
        let page = Page {
            title: words.clone(),
            subtitle: words.clone(),
            language: Language::German,
            sections: vec![PageSection {
                heading: words.clone(),
                blocks: vec![
                    PageBlock::Text(words.clone()),
                    PageBlock::Note(words.clone()),
                    PageBlock::Facts(vec![(words.clone(), words.clone())]),
                    PageBlock::Findings(vec![PageFinding {
                        standing: standing.clone(),
                        title: words.clone(),
                        words: vec![words.clone()],
                    }]),
                    PageBlock::Table(PageTable {
                        caption: words.clone(),
                        header: vec![words.clone(); 3],
                        rows: vec![vec![
                            TableCell::Words(words.clone()),
                            TableCell::Number("1.5".into()),
                            TableCell::Standing(standing),
                        ]],
                    }),
                    PageBlock::Figure(Box::new(figure(2))),
                    PageBlock::Figure(Box::new(figure(0))),
                ],
            }],
        };
        let html = page.html();
        let elements = elements(&html);
        assert!(!elements.contains(&"script".to_string()));
        let count = |name: &str| elements.iter().filter(|element| *element == name).count();
        assert_eq!((count("td"), count("th"), count("figure"), count("section")), (3, 3, 2, 1));
        assert!(html.contains("class=\"number\">1.5</td>") && html.contains("no data"));
    }

    #[test]
    fn a_picture_has_a_drawing_a_panel_and_a_legend_of_words() {
        let html = figure(3).html();
        let drawings = elements(&html).iter().filter(|element| *element == "svg").count();
        assert_eq!(drawings, 4, "three panels and an entry of the legend");
        assert!(html.contains("</svg>a &lt; b</li>"));
    }
}
