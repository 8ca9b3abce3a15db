//! A page in another language: its texts are keys of the tables of messages. Other texts, such as names, stay as they
//! are.

use super::figure::{Figure, Panel};
use super::page::{Page, PageBlock, TableCell};
use crate::language::{Language, finding, translated};

impl Page {
    /// The page in a language.
    #[must_use]
    pub fn in_language(mut self, language: Language) -> Self {
        self.language = language;
        let change = |text: &mut String| *text = in_words(language, text);
        change(&mut self.title);
        change(&mut self.subtitle);
        for section in &mut self.sections {
            change(&mut section.heading);
            section.blocks.iter_mut().for_each(|block| translate_block(block, &change));
        }
        self
    }
}

/// A text in a language: as a whole, or each of its sentences and parts.
fn in_words(language: Language, text: &str) -> String {
    let whole = translated(language, text);
    if whole != text {
        return whole.into_owned();
    }
    let parts = |separator: &str, close: &str| {
        let parts: Vec<String> =
            text.split(separator).map(|part| translated(language, part).into_owned()).collect();
        let joined = parts.join(separator);
        (joined != text).then(|| joined + close)
    };
    of_detector(language, text)
        .or_else(|| parts("; ", ""))
        .or_else(|| parts(", ", ""))
        .unwrap_or_else(|| text.to_owned())
}

/// A message of a detector that was written as a sentence; `None` for other texts.
fn of_detector(language: Language, text: &str) -> Option<String> {
    let plain = text.strip_suffix('.').unwrap_or(text);
    let message = with_first(plain, |letter| letter.to_lowercase().to_string());
    let said = finding(language, &message);
    let end = if plain == text { "" } else { "." };
    (said != message).then(|| with_first(&said, |letter| letter.to_uppercase().to_string()) + end)
}

fn with_first(text: &str, change: impl Fn(char) -> String) -> String {
    let mut letters = text.chars();
    letters.next().map_or_else(String::new, |first| change(first) + letters.as_str())
}

fn translate_block(block: &mut PageBlock, change: &dyn Fn(&mut String)) {
    match block {
        PageBlock::Text(words) | PageBlock::Note(words) => change(words),
        PageBlock::Facts(facts) => facts.iter_mut().for_each(|(name, words)| {
            change(name);
            change(words);
        }),
        PageBlock::Findings(findings) => {
            for finding in findings {
                change(&mut finding.title);
                change(&mut finding.standing.word);
                finding.words.iter_mut().for_each(change);
            }
        }
        PageBlock::Table(table) => {
            change(&mut table.caption);
            table.header.iter_mut().for_each(change);
            for cell in table.rows.iter_mut().flatten() {
                match cell {
                    TableCell::Words(words) => change(words),
                    TableCell::Standing(of) => change(&mut of.word),
                    TableCell::Number(_) => {}
                }
            }
        }
        PageBlock::Figure(figure) => translate_figure(figure, change),
    }
}

fn translate_figure(figure: &mut Figure, change: &dyn Fn(&mut String)) {
    change(&mut figure.title);
    change(&mut figure.subtitle);
    figure.legend.iter_mut().for_each(|key| change(&mut key.label));
    for panel in &mut figure.panels {
        let Panel { title, standing, x_label, y_label, series, strip, .. } = panel;
        [title, x_label, y_label].into_iter().for_each(change);
        standing.iter_mut().for_each(|of| change(&mut of.word));
        series.iter_mut().for_each(|of| change(&mut of.name));
        if let Some(strip) = strip {
            change(&mut strip.y_label);
            strip.series.iter_mut().for_each(|of| change(&mut of.name));
        }
    }
}
