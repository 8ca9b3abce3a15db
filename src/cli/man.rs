//! `armwatch man`: manual pages, one a command.

use std::io::Write;
use std::path::PathBuf;

use clap::{Args, Command};
use clap_mangen::Man;
use roff::{Roff, roman};
use serde_json::json;

use super::context::{CliError, EXIT_DONE, Global};
use super::help::{HelpBlock, blocks};
use super::shared::output;
use super::shared::paths::not_written;

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  armwatch man ~/.local/share/man/man1
  armwatch man /usr/local/share/man/man1

There is one page per command: armwatch.1, armwatch-ingest.1, armwatch-alerts-show.1 and so on. `man armwatch`
finds a folder man1 below a folder of MANPATH immediately, as in the examples. Pages of an earlier version are
replaced.")]
pub(super) struct ManArgs {
    /// Folder to write to; created if missing
    #[arg(value_name = "DIR")]
    folder: PathBuf,
}

/// Writes pages of all of `command`.
pub(super) fn man(global: &Global, args: &ManArgs, command: Command) -> Result<u8, CliError> {
    let folder = &args.folder;
    std::fs::create_dir_all(folder).map_err(|error| not_written(folder, &error))?;
    let mut command = command.disable_help_subcommand(true);
    command.build();
    let version = command.get_version().unwrap_or_default().to_owned();
    let mut commands = Vec::new();
    shown(&command, &mut commands);
    let pages = commands.len();
    for command in commands {
        let name = command.get_display_name().unwrap_or_else(|| command.get_name()).to_owned();
        let path = folder.join(format!("{name}.1"));
        let page = page(&name, &version, command).map_err(|error| not_written(&path, &error))?;
        std::fs::write(&path, page).map_err(|error| not_written(&path, &error))?;
    }
    let first = folder.join("armwatch.1");
    if global.json {
        output::json(&json!({"folder": folder.display().to_string(), "pages": pages}));
    } else {
        output::line(&format!(
            "{pages} pages in {}; read them with `man {}`",
            folder.display(),
            first.display()
        ));
    }
    Ok(EXIT_DONE)
}

fn shown(command: &Command, found: &mut Vec<Command>) {
    found.push(command.clone());
    for command in command.get_subcommands().filter(|command| !command.is_hide_set()) {
        shown(command, found);
    }
}

fn page(name: &str, version: &str, command: Command) -> std::io::Result<Vec<u8>> {
    let text = command.get_after_long_help().map(ToString::to_string).unwrap_or_default();
    let has_commands = command.has_subcommands();
    let page =
        Man::new(command).title(name.to_uppercase()).source(format!("armwatch {version}")).manual("armwatch");
    let mut bytes = Vec::new();
    page.render_title(&mut bytes)?;
    page.render_name_section(&mut bytes)?;
    page.render_synopsis_section(&mut bytes)?;
    page.render_description_section(&mut bytes)?;
    let (titled, prose): (Vec<HelpBlock>, Vec<HelpBlock>) =
        blocks(&text).into_iter().partition(|block| block.is_examples() || block.prose == "Exit status:");
    let mut roff = Roff::new();
    prose.iter().for_each(|block| {
        roff.control("PP", []).text([roman(&*block.prose)]);
        literal(&mut roff, &block.lines);
    });
    bytes.write_all(roff.to_roff().as_bytes())?;
    if has_commands {
        page.render_subcommands_section(&mut bytes)?;
    }
    page.render_options_section(&mut bytes)?;
    let mut roff = Roff::new();
    for block in titled {
        roff.control("SH", [block.prose.trim_end_matches(':').to_uppercase().as_str()]);
        literal(&mut roff, &block.lines);
    }
    bytes.write_all(roff.to_roff().as_bytes())?;
    Ok(bytes)
}

/// Lines that are not filled.
fn literal(roff: &mut Roff, lines: &[String]) {
    if lines.is_empty() {
        return;
    }
    roff.control("PP", []).control("nf", []);
    for line in lines {
        roff.text([roman(line.strip_prefix("  ").unwrap_or(line))]);
    }
    roff.control("fi", []);
}
