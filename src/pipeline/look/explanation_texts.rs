//! Problems and remarks of an explanation as sentences.

use crate::pipeline::look::explain::{Explanation, ExportReading};
use crate::pipeline::stored::chosen_cycles::in_ranges;
use armwatch_ingest::table::cell_reader::PassedOver;
use armwatch_ingest::table::reader::LeftOut;
use armwatch_model::analysis::CycleAnalysis;

impl Explanation {
    /// Faults of the export, the worst first, with line, column, value and remedy.
    #[must_use]
    pub fn problems(&self) -> Vec<String> {
        let mut problems: Vec<String> = self.rejection.iter().map(|rejection| rejection.sentence()).collect();
        let Some(reading) = &self.reading else { return problems };
        problems.extend(reading.left_out.map(|LeftOut { line, reason }| {
            format!("line {line}: the last line {reason}; the row is skipped")
        }));
        if reading.passed_over.rows > 0 {
            let permitted = self.recognised.as_ref().map_or(0, |of| of.entry.layout.rows.skip_bad);
            problems.push(passed_over_text(&reading.passed_over, permitted));
        }
        problems.extend(reading.refusals());
        problems
    }

    /// Doubts about name and start, and the remarks of the reading.
    #[must_use]
    pub fn remarks(&self) -> Vec<String> {
        let of_reading = self.reading.iter().flat_map(ExportReading::remarks);
        self.doubts.iter().cloned().chain(of_reading).collect()
    }
}

impl ExportReading {
    /// Reasons why cycles are refused.
    #[must_use]
    pub fn refusals(&self) -> Vec<String> {
        self.said_of_cycles(|analysis| {
            analysis.refusal().map(|reason| format!("no parameters: {reason}")).into_iter().collect()
        })
    }

    /// Rows that were repaired or omitted, and remarks of the analysis about accepted cycles.
    #[must_use]
    pub fn remarks(&self) -> Vec<String> {
        let mut remarks = self.mended.sentences();
        remarks.extend(self.said_of_cycles(|analysis| analysis.remarks.clone()));
        remarks
    }

    /// Remarks about cycles; a remark about several cycles appears once, with their numbers.
    fn said_of_cycles(&self, of: impl Fn(&CycleAnalysis) -> Vec<String>) -> Vec<String> {
        let mut said: Vec<(String, Vec<u32>)> = Vec::new();
        for cycle in &self.cycles {
            for text in cycle.analysis.as_ref().map(&of).unwrap_or_default() {
                match said.iter_mut().find(|(known, _)| *known == text) {
                    Some((_, cycles)) => cycles.push(cycle.cycle),
                    None => said.push((text, vec![cycle.cycle])),
                }
            }
        }
        let numbered = |(text, cycles): (String, Vec<u32>)| {
            format!("cycle {}: {text}", in_ranges(cycles.into_iter().map(i64::from)))
        };
        said.into_iter().map(numbered).collect()
    }
}

fn passed_over_text(passed_over: &PassedOver, permitted: u64) -> String {
    let rows = passed_over.rows;
    let (s, are) = if rows == 1 { ("", "is") } else { ("s", "are") };
    let first = passed_over
        .first
        .as_ref()
        .map_or_else(String::new, |first| format!("; the first: {}", first.sentence()));
    format!("{rows} bad row{s} {are} skipped, the layout permits {permitted} (skip_bad){first}")
}
