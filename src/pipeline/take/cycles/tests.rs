use super::*;
use armwatch_config::parse_layout;
use armwatch_model::run::{Stage, StageReading};
use armwatch_testing::cycle::cycle;
use armwatch_testing::er3a;

const NATIVE: &str = include_str!("../../../../config/exports/native.toml");

/// The native layout with another section `[stage]`.
fn layout(section: &str) -> Layout {
    let start = NATIVE.find("[stage]").expect("a section");
    let end = NATIVE.find("# Optional columns").expect("what follows");
    let text = format!("{}[stage]\n{section}\n{}", &NATIVE[..start], &NATIVE[end..]);
    parse_layout("layout.toml", &text).expect("no problems")
}

/// Three cycles one after the other, without a counter.
fn recording() -> Samples {
    let mut recording = Samples::default();
    for _ in 0..3 {
        let mut samples = Samples { cycle: None, ..cycle(1, 1500).samples };
        let offset = recording.time.last().map_or(0.0, |last| last + samples.time[1]);
        samples.time.iter_mut().for_each(|time| *time += offset);
        recording.append(samples);
    }
    recording
}

#[test]
fn a_counter_that_falls_is_told_with_line_column_and_value_whatever_the_pieces() {
    let layout = parse_layout("layout.toml", NATIVE).expect("no problems");
    let mut recording = cycle(2, 1500).samples;
    let counters = recording.cycle.get_or_insert_with(|| vec![2; 1500]);
    counters[1200] = 1;
    let rows = recording.clone().with_stages(StageReading::Known(recording.stage.clone()));
    for chunk in [1, 7, 1000, 1500] {
        let (mut left, mut cutter) = (rows.clone(), cutter_of(&layout));
        // the header is line 1
        let (mut line, mut fault) = (2, None);
        while fault.is_none() && !left.is_empty() {
            let piece = left.take_front(chunk.min(left.rows()));
            cutter.note_line(line);
            line += piece.rows() as u64;
            cutter.push(piece);
            fault = all(&mut cutter).1;
        }
        let fault = fault.expect("a fault");
        assert_eq!(
            (fault.line, fault.column.as_deref(), fault.value.as_deref()),
            (Some(1202), Some("cycle"), Some("1")),
            "pieces of {chunk} rows"
        );
        let told = fault.sentence();
        assert!(told.contains("\"1\" is below the 2 that the cycle counter had reached"), "{told}");
    }
}

fn cutter_of(layout: &Layout) -> RowCutter {
    RowCutter::new(Path::new("a.csv"), layout, &er3a()).expect("a cutter")
}

fn cut(layout: &Layout, mut rows: RawSamples, chunk: usize) -> Vec<Cycle> {
    let (cycles, fault) = cut_or_not(layout, &mut rows, chunk);
    assert_eq!(fault, None);
    cycles
}

/// The cycles that the pushed rows end, and the fault after them.
fn all(cutter: &mut RowCutter) -> (Vec<Cycle>, Option<Rejection>) {
    let mut cycles = Vec::new();
    loop {
        match cutter.next_cycle() {
            Ok(Some(cycle)) => cycles.push(cycle),
            Ok(None) => return (cycles, None),
            Err(fault) => return (cycles, Some(fault)),
        }
    }
}

fn cut_or_not(layout: &Layout, rows: &mut RawSamples, chunk: usize) -> (Vec<Cycle>, Option<Rejection>) {
    let mut cutter = cutter_of(layout);
    let (mut cycles, mut line) = (Vec::new(), 2);
    while !rows.is_empty() {
        let piece = rows.take_front(chunk.min(rows.rows()));
        cutter.note_line(line);
        line += piece.rows() as u64;
        cutter.push(piece);
        let (more, fault) = all(&mut cutter);
        cycles.extend(more);
        if fault.is_some() {
            return (cycles, fault);
        }
    }
    cutter.finish();
    let (more, fault) = all(&mut cutter);
    cycles.extend(more);
    (cycles, fault)
}

/// Rows with a counter of cycles of these lengths.
fn rows_of(lengths: &[usize]) -> RawSamples {
    let rows = lengths.iter().sum();
    let mut samples = cycle(1, 1500).samples;
    while samples.rows() < rows {
        samples.append(cycle(1, 1500).samples);
    }
    let mut samples = samples.take_front(rows);
    let counters = lengths.iter().zip(1..).flat_map(|(rows, number)| std::iter::repeat_n(number, *rows));
    samples.cycle = Some(counters.collect());
    samples.with_stages(StageReading::Known(vec![Stage::Excitation; rows]))
}

#[test]
fn a_counter_that_counts_rows_is_told_and_gives_no_cycle_whatever_the_pieces() {
    let layout = parse_layout("layout.toml", NATIVE).expect("no problems");
    for (lengths, given, line, told) in [
        (
            vec![1; 1000],
            0,
            2,
            "the column cycle counts rows, not cycles: 100 cycles in a row have 1 row each",
        ),
        (
            vec![5; 400],
            0,
            2,
            "the column cycle changes too often to count cycles: 100 cycles in a row have 5 rows each",
        ),
        (vec![1; 12], 0, 2, "12 cycles in a row have 1 row each"),
        ([vec![500, 40], vec![31; 120]].concat(), 2, 542, "100 cycles in a row have 31 rows each"),
        (
            [vec![20; 60], vec![500], [1, 3].repeat(60)].concat(),
            61,
            1702,
            "100 cycles in a row have 1 to 3 rows",
        ),
    ] {
        for chunk in [1, 7, 999, 100_000] {
            let (cycles, fault) = cut_or_not(&layout, &mut rows_of(&lengths), chunk);
            let fault = fault.expect("a fault");
            assert_eq!((cycles.len(), fault.line), (given, Some(line)), "{fault} in pieces of {chunk}");
            assert!(fault.sentence().contains(told) && fault.remedy.contains("[if_present]"), "{fault}");
        }
    }
}

#[test]
fn stages_that_flicker_are_told_as_such() {
    let layout = parse_layout("layout.toml", NATIVE).expect("no problems");
    let rows: Vec<Stage> = (0..900).map(|row| Stage::ANALYSED[2 - row % 3]).collect();
    let mut flickering = rows_of(&[900]).with_stages(StageReading::Known(rows));
    flickering.cycle = None;
    let (cycles, fault) = cut_or_not(&layout, &mut flickering, 250);
    let fault = fault.expect("a fault").sentence();
    assert!(cycles.is_empty() && fault.contains("the stage signal returns"), "{fault}");
}

#[test]
fn short_cycles_among_longer_ones_and_few_of_them_are_cycles() {
    let layout = parse_layout("layout.toml", NATIVE).expect("no problems");
    for lengths in [
        vec![32; 300],
        [1, 40].repeat(150),
        vec![31; 9],
        [vec![500], vec![1; 99]].concat(),
        [vec![1; 99], vec![500], vec![1; 99], vec![32]].concat(),
    ] {
        for chunk in [1, 99, 100_000] {
            let cycles = cut(&layout, rows_of(&lengths), chunk);
            let found: Vec<usize> = cycles.iter().map(|cycle| cycle.samples.rows()).collect();
            assert_eq!(found, lengths, "in pieces of {chunk}");
        }
    }
}

#[test]
fn levels_cut_the_cycles_that_their_stages_cut_whatever_the_pieces() {
    let numbers =
        layout("column = \"stage\"\nbetween = [0]\nexcitation = [1]\nfriction = [2]\nwarming = [3]");
    let levels = layout(
        "kind = \"levels\"\ncolumn = \"stage\"\nbetween = [-0.5, 0.5]\nexcitation = [2, 3]\nfriction = [4.5, 5.5]\n\
         warming = [7, 8]\nhysteresis = 0.1\ndebounce_s = 0.05",
    );
    let staged = recording();
    let recorded = staged.clone().with_stages(StageReading::Known(staged.stage.clone()));
    let expected = cut(&numbers, recorded, staged.rows());
    assert_eq!(expected.len(), 3);
    let level = |(row, stage): (usize, &Stage)| {
        // noise within the ranges and, apart from boundaries, an occasional spike
        let inside = row >= 10 && staged.stage[row - 10] == *stage;
        let spike = if inside && row % 97 == 50 { 2.5 } else { 0.0 };
        2.5 * f64::from(*stage as u8) + spike + 0.4 * (row as f64).sin()
    };
    let levels_of_rows = staged.stage.iter().enumerate().map(level).collect();
    let analogue = staged.clone().with_stages(StageReading::Level(levels_of_rows));
    for chunk in [1, 7, 100, 1499, 4500] {
        assert_eq!(cut(&levels, analogue.clone(), chunk), expected, "pieces of {chunk} rows");
    }
}

#[test]
fn motion_and_windows_cut_the_same_whatever_the_pieces() {
    for section in ["kind = \"motion\"", "kind = \"production\"\nwindow_s = 5"] {
        let layout = layout(section);
        let rows = recording().with_stages(StageReading::Unknown);
        let whole = cut(&layout, rows.clone(), rows.rows());
        assert!(!whole.is_empty(), "{section}");
        for chunk in [1, 13, 500] {
            assert_eq!(cut(&layout, rows.clone(), chunk), whole, "{section} in pieces of {chunk} rows");
        }
    }
}
