//! `armwatch completions`: scripts that let a shell complete commands and options.

use clap::{Args, Command};
use clap_complete::Shell;

use super::context::{CliError, EXIT_DONE};
use super::shared::output;

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  armwatch completions bash \\
      > ~/.local/share/bash-completion/completions/armwatch
  armwatch completions zsh > ~/.zfunc/_armwatch
  armwatch completions fish > ~/.config/fish/completions/armwatch.fish")]
pub(super) struct CompletionsArgs {
    /// Name of the shell
    #[arg(value_enum)]
    shell: Shell,
}

/// Prints completions for all of `command`.
pub(super) fn completions(args: &CompletionsArgs, command: &mut Command) -> Result<u8, CliError> {
    let name = command.get_name().to_owned();
    let mut script = Vec::new();
    clap_complete::generate(args.shell, command, name, &mut script);
    output::lines(String::from_utf8_lossy(&script).lines().map(str::to_owned));
    Ok(EXIT_DONE)
}
