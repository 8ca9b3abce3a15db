//! Checks that any bytes give rows or a rejection, independent of the size of the blocks, and that the reader of cells
//! reads the same numbers as the reader of blocks.
//!
//! The first byte of an input selects a layout, and whether the header of the layout precedes the other bytes.

use std::path::Path;
use std::sync::OnceLock;

use armwatch_config::{Layout, parse_layout, parse_robot};
use armwatch_ingest::bytes::blocks::{Blocks, Next};
use armwatch_ingest::rejection::Rejection;
use armwatch_ingest::table::column_map::map_columns;
use armwatch_ingest::table::parser::Parser;
use armwatch_ingest::table::reader::{ExportReader, ReadOptions};
use armwatch_ingest::table::{cell_reader, preamble};
use armwatch_model::robot::Robot;
use armwatch_model::run::RawSamples;

const ROBOT: &str = include_str!("../../config/robots/scara.toml");

/// Names of the columns of a four-axis arm, with `,` for the delimiter.
const HEADER: &str = "time,pos_1,pos_2,pos_3,pos_4,trq_1,trq_2,trq_3,trq_4,stage,cycle\n";

const COLUMNS: &str = "[position]\ncolumn = \"pos_{joint}\"\nunit = \"rad\"\n[torque]\ncolumn = \"trq_{joint}\"\n\
     unit = \"Nm\"\n[stage]\ncolumn = \"stage\"\nbetween = [0]\nexcitation = [1]\nfriction = [2]\nwarming = [3]\n\
     [if_present]\ncycle = \"cycle\"\n";

/// Delimiter, other keys, and keys of time.
const KINDS: [(char, &str, &str); 7] = [
    (',', "", "unit = \"s\""),
    (';', "decimal = \",\"", "unit = \"ms\""),
    (',', "decimal = \",\"", "unit = \"s\""),
    ('\t', "encoding = \"utf-8\"\nskip_after_header = 1", "unit = \"timestamp\""),
    (',', "encoding = \"windows-1252\"\nskip_lines = 1", "unit = \"ticks\"\ntick_s = 0.004\nwraps_at = 256"),
    (';', "decimal = \",\"", "unit = \"timestamp\""),
    (' ', "", "unit = \"s\""),
];

struct Kind {
    layout: Layout,
    header: String,
}

fn kinds() -> &'static (Robot, Vec<Kind>) {
    static MADE: OnceLock<(Robot, Vec<Kind>)> = OnceLock::new();
    MADE.get_or_init(|| {
        let robot = parse_robot("scara.toml", ROBOT).expect("the shipped arm");
        let kind = |(delimiter, keys, time): &(char, &str, &str)| {
            let sign = match delimiter {
                '\t' => "\\t".to_owned(),
                ' ' => "blank".to_owned(),
                sign => sign.to_string(),
            };
            let text = format!(
                "name = \"fuzz\"\ndelimiter = \"{sign}\"\n{keys}\n[time]\ncolumn = \"time\"\n{time}\n{COLUMNS}"
            );
            let layout = parse_layout("fuzz.toml", &text).expect("a layout");
            Kind { layout, header: HEADER.replace(',', &delimiter.to_string()) }
        };
        (robot, KINDS.iter().map(kind).collect())
    })
}

/// All rows before the end or the error, and the error.
fn read(bytes: &[u8], layout: &Layout, robot: &Robot, block_bytes: usize) -> (RawSamples, Option<Rejection>) {
    let options = ReadOptions { block_bytes };
    let reader = match ExportReader::new(bytes, Path::new("fuzz.csv"), layout, robot, options) {
        Ok(reader) => reader,
        Err(rejection) => return (RawSamples::default(), Some(rejection)),
    };
    let mut rows = RawSamples::default();
    for item in reader {
        match item {
            Ok(chunk) => rows.append(chunk.samples),
            Err(rejection) => return (rows, Some(rejection)),
        }
    }
    (rows, None)
}

/// Checks that the reader of blocks and the reader of cells agree about one block.
fn agree(bytes: &[u8], layout: &Layout, robot: &Robot) {
    let path = Path::new("fuzz.csv");
    let mut blocks = Blocks::new(bytes, 1 << 20, layout.text.encoding);
    let Ok(Some(header)) = preamble::read(&mut blocks, layout, path) else { return };
    let Ok(map) = map_columns(&header.text, layout, robot, path) else { return };
    let Ok(Next::Block(block)) = blocks.next_block(path) else { return };
    let fast = Parser::new(map.clone()).read(&block, None, path);
    assert_eq!(fast, cell_reader::read(&block, &map, None, path));
}

/// Checks one input; a failure panics.
pub fn run(data: &[u8]) {
    let Some((choice, bytes)) = data.split_first() else { return };
    let (robot, kinds) = kinds();
    let kind = &kinds[usize::from(choice & 0x7F) % kinds.len()];
    let mut file = Vec::new();
    if choice & 0x80 != 0 {
        file.extend_from_slice(kind.header.as_bytes());
    }
    file.extend_from_slice(bytes);
    let whole = read(&file, &kind.layout, robot, 1 << 20);
    assert_eq!(read(&file, &kind.layout, robot, 48), whole, "blocks of 48 bytes and of all");
    agree(&file, &kind.layout, robot);
}
