//! Files that were cut while they were written, so that rows continue without their header.

use std::io::Read;
use std::path::Path;

use super::{ExportReader, ReadOptions};
use crate::bytes::blocks::Blocks;
use crate::rejection::Rejection;
use crate::table::cell;
use crate::table::fields::fields;
use crate::table::preamble::Header;
use armwatch_config::Layout;
use armwatch_model::robot::Robot;

impl<R: Read> ExportReader<R> {
    /// Like [`ExportReader::of_growing`], for a file without a header whose rows continue those of an earlier file with
    /// the header `header`: a tool has copied that file and cut it while it was written. The first line is skipped,
    /// since the cut may have left only a part of it. `None` as long as there is no second one.
    ///
    /// # Errors
    /// Those of [`ExportReader::new`], and a rejection if the first lines are not rows under that header.
    pub fn going_on(
        reader: R,
        header: &str,
        path: &Path,
        layout: &Layout,
        robot: &Robot,
        options: ReadOptions,
    ) -> Result<Option<Self>, Rejection> {
        let mut blocks = Blocks::new(reader, options.block_bytes, layout.text.encoding);
        let (Some(first), Some(second)) = (blocks.next_line(path)?, blocks.next_line(path)?) else {
            return Ok(None);
        };
        let columns = fields_of(header, layout);
        if !fields_of(&first.text, layout).may_be_cut(&columns)
            || !fields_of(&second.text, layout).is_row(&columns)
        {
            let reason = "neither a header nor rows of the header that the file had before";
            return Err(Rejection::of_file(path, reason, "export again, with a header").at_line(first.number));
        }
        blocks.put_back(second);
        let header = Header { text: header.to_owned(), line: 0 };
        let mut read = Self::with_header(blocks, &header, path, layout, robot)?;
        read.header_line = None;
        Ok(Some(read))
    }
}

/// Fields of a line.
struct Fields {
    count: usize,
    /// Number of numeric fields.
    numbers: usize,
}

fn fields_of(text: &str, layout: &Layout) -> Fields {
    let all = || fields(text, layout.delimiter);
    let numbers = all().filter(|field| cell::number(field, layout.text.decimal).is_ok()).count();
    Fields { count: all().count(), numbers }
}

impl Fields {
    /// Returns true for a row of these columns.
    fn is_row(&self, columns: &Self) -> bool {
        self.count == columns.count && 2 * self.numbers > self.count
    }

    /// Returns true for the end of such a row.
    fn may_be_cut(&self, columns: &Self) -> bool {
        self.count <= columns.count && self.numbers > 0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixture::{made_recording, native};
    use armwatch_testing::er3a;

    fn read(text: &str, header: &str) -> Result<Option<u64>, Rejection> {
        let path = Path::new("a.csv");
        let reader = ExportReader::going_on(
            text.as_bytes(),
            header,
            path,
            &native(),
            &er3a(),
            ReadOptions::default(),
        )?;
        let Some(mut reader) = reader else { return Ok(None) };
        assert_eq!(reader.header(), Some(header));
        reader.by_ref().try_for_each(|chunk| chunk.map(|_| ()))?;
        Ok(Some(reader.rows()))
    }

    #[test]
    fn rows_are_read_by_the_header_before_them_and_other_files_are_not() {
        let (_, text) = made_recording(200);
        let (header, rows) = text.split_once('\n').unwrap();
        // the first row may be cut, also within its time
        for cut in [0, 1, rows.find(',').unwrap() + 3] {
            assert_eq!(read(&rows[cut..], header), Ok(Some(199)), "{cut}");
        }
        assert_eq!(read("", header), Ok(None));
        assert_eq!(read(rows.split_once(',').unwrap().0, header), Ok(None), "no line is whole");
        for other in [&text, "a,b\nc,d\n", "1,2\n3,4\n"] {
            let refused = read(other, header).unwrap_err();
            assert!(refused.reason.contains("neither a header nor rows"), "{refused}");
        }
    }
}
