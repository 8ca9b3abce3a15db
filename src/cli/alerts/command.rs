//! `armwatch alerts`: anomalies, people's answers to them, and their histories.

use clap::{ArgGroup, Args, Subcommand};
use jiff::Timestamp;

use super::act::{self, AlarmCommand};
use super::list::{self, Wanted};
use super::quantities::quantities;
use super::show;
use super::test::{self, TestArgs};
use crate::cli::context::{CliError, Global, open_to_change, open_to_read, runtime};
use crate::cli::shared::moment::moment;
use crate::cli::shared::named_value::{one_of, plain};
use crate::cli::shared::plot::PlotFile;
use crate::cli::shared::said::said;
use armwatch_model::anomaly::{AnomalyKind, Severity};
use armwatch_store::AlarmState;

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  armwatch alerts list
  armwatch alerts show 4
  armwatch alerts ack 4 --why \"gearbox is ordered\"
  armwatch alerts shelve 4 --days 14 --why \"gearbox comes in two weeks\"
  armwatch alerts resolve 4 --why \"gearbox changed\"
  armwatch alerts false-alarm 4 --why \"other gripper during the test\"
  armwatch alerts test shift

docs/alarms.md explains the states and when each of them ends.")]
pub(in crate::cli) struct AlertsArgs {
    #[command(subcommand)]
    command: AlertsCommand,
}

#[derive(Debug, Subcommand)]
enum AlertsCommand {
    /// List anomalies that are not closed, the worst first
    #[command(after_help = "\
Examples:
  armwatch alerts list
  armwatch alerts list --robot R07 --severity warning,critical
  armwatch alerts list --state shelved
  armwatch alerts list --all --json | jq .message")]
    List(ListArgs),
    /// Show one anomaly: values, causes, tests before and after the onset, history
    #[command(after_help = "\
Examples:
  armwatch alerts show 4
  armwatch alerts show 4 --plot alarm4.svg
  armwatch alerts show 4 --json | jq .history")]
    Show(ShowArgs),
    /// Acknowledge anomalies
    ///
    /// Also ends the states shelved, maintenance, resolved and false_alarm, as long as tests show the anomaly.
    #[command(after_help = "\
Examples:
  armwatch alerts ack 4
  armwatch alerts ack 4 7 --by mueller --why \"gearbox is ordered\"")]
    Ack(DeedArgs),
    /// Silence anomalies for a time
    #[command(after_help = "\
Examples:
  armwatch alerts shelve 4 --days 14 --why \"gearbox comes in two weeks\"
  armwatch alerts shelve 4 --until 2099-01-07 --why \"works holidays\"
  armwatch alerts shelve 4 --until 2099-01-07T06:00

Shelving ends at the given time, or earlier if the severity rises. The anomaly is then open. A critical anomaly
can be shelved for at most 90 days. Dates begin at midnight UTC. Times are in UTC unless they have an offset, such
as 2099-01-07T06:00:00+02:00.")]
    Shelve(ShelveArgs),
    /// Mark anomalies as resolved: the cause is gone
    #[command(after_help = "\
Examples:
  armwatch alerts resolve 4 --why \"gearbox changed\"

The anomaly is open again if a later test still shows it. After a repair, enter the work with `armwatch
maintenance` instead. This begins a new baseline and puts earlier alarms into the state maintenance.")]
    Resolve(DeedArgs),
    /// Mark anomalies as false alarms: nothing was wrong
    #[command(after_help = "\
Examples:
  armwatch alerts false-alarm 4 --why \"other gripper during the test\"

The episode stays closed even if further tests show it. `armwatch alerts reopen` opens it again.")]
    FalseAlarm(DeedArgs),
    /// Undo an answer: the alarm is open again
    #[command(after_help = "\
Examples:
  armwatch alerts reopen 4 --why \"resolved by mistake\"

Ends the states acknowledged, shelved, resolved, maintenance and false_alarm. Work that was entered stays;
`armwatch maintenance --remove` deletes it.")]
    Reopen(DeedArgs),
    /// List the quantities of anomalies with their units
    #[command(after_help = "\
Examples:
  armwatch alerts quantities
  armwatch alerts quantities --json | jq -r 'select(.unit == \"Nm\").quantity'")]
    Quantities,
    /// Send a test message on routes
    Test(TestArgs),
}

#[derive(Debug, Args)]
struct ListArgs {
    /// Show only anomalies of this robot
    #[arg(long, value_name = "NAME")]
    robot: Option<String>,
    /// Show only these states, including closed ones
    #[arg(long, value_name = "STATE", value_delimiter = ',', value_parser = one_of(AlarmState::ALL, AlarmState::name, plain))]
    state: Vec<AlarmState>,
    /// Show only these severities
    #[arg(long, value_name = "SEVERITY", value_delimiter = ',', value_parser = one_of(Severity::ALL, Severity::name, plain))]
    severity: Vec<Severity>,
    /// Show only these kinds
    #[arg(long, value_name = "KIND", value_delimiter = ',', value_parser = one_of(AnomalyKind::ALL, AnomalyKind::name, AnomalyKind::help))]
    kind: Vec<AnomalyKind>,
    /// Include closed anomalies: resolved and false alarms
    #[arg(long)]
    all: bool,
}

#[derive(Debug, Args)]
struct ShowArgs {
    /// Number of the anomaly
    #[arg(value_name = "ID")]
    id: i64,
    /// Draw friction and RMSD of the tests into this .svg or .html file
    #[arg(long, value_name = "FILE", value_parser = PlotFile::parse)]
    plot: Option<PlotFile>,
}

/// What a person gives with every deed.
#[derive(Debug, Args)]
struct DeedArgs {
    /// Numbers of the anomalies
    #[arg(required = true, value_name = "ID")]
    ids: Vec<i64>,
    /// Reason, for later readers of the history
    #[arg(long, value_name = "TEXT", value_parser = said)]
    why: Option<String>,
    /// Name of the person [default: the user's name]
    #[arg(long, value_name = "NAME", value_parser = said)]
    by: Option<String>,
}

#[derive(Debug, Args)]
#[command(group(ArgGroup::new("end").args(["until", "days"]).required(true)))]
struct ShelveArgs {
    #[command(flatten)]
    deed: DeedArgs,
    /// End of the silence, UTC: a date, a date with time, or RFC 3339 with an offset
    #[arg(long, value_name = "TIME", value_parser = moment)]
    until: Option<Timestamp>,
    /// Number of days from now
    #[arg(long, value_name = "N", allow_negative_numbers = true, value_parser = clap::value_parser!(i64).range(1..=3650))]
    days: Option<i64>,
}

pub(in crate::cli) fn alerts(global: &Global, args: &AlertsArgs) -> Result<u8, CliError> {
    if matches!(args.command, AlertsCommand::Quantities) {
        return Ok(quantities(global));
    }
    let config = global.read_config()?;
    runtime()?.block_on(async {
        let now = Timestamp::now();
        let store = match args.command {
            AlertsCommand::List(_) | AlertsCommand::Show(_) => open_to_read(&config).await?,
            _ => {
                let store = open_to_change(&config).await?;
                store.end_shelving(now).await?;
                store
            }
        };
        let done = match &args.command {
            AlertsCommand::List(ListArgs { robot, state, severity, kind, all }) => {
                let wanted = Wanted {
                    robot: robot.as_deref(),
                    states: state,
                    severities: severity,
                    kinds: kind,
                    all: *all,
                };
                list::list(global, &store, &wanted, now).await
            }
            AlertsCommand::Quantities => Ok(quantities(global)),
            AlertsCommand::Test(args) => test::test(global, &store, &config.alerts, args).await,
            AlertsCommand::Show(args) => show::show(global, &store, args.id, args.plot.as_ref(), now).await,
            AlertsCommand::Ack(args) => act::act(global, &store, &deed(args), act::ACKNOWLEDGE).await,
            AlertsCommand::Reopen(args) => act::act(global, &store, &deed(args), act::REOPEN).await,
            AlertsCommand::Resolve(args) => act::act(global, &store, &deed(args), act::RESOLVE).await,
            AlertsCommand::FalseAlarm(args) => act::act(global, &store, &deed(args), act::FALSE_ALARM).await,
            AlertsCommand::Shelve(ShelveArgs { deed: args, until, days }) => {
                let until = match (until, days) {
                    (Some(until), _) => Ok(*until),
                    (None, Some(days)) => act::days_after(now, *days),
                    (None, None) => Err(CliError::Usage("give --until TIME or --days N".into())),
                };
                act::shelve(global, &store, &deed(args), until?, now).await
            }
        };
        store.close().await?;
        done
    })
}

fn deed(args: &DeedArgs) -> AlarmCommand<'_> {
    AlarmCommand { ids: &args.ids, by: args.by.as_deref(), why: args.why.as_deref() }
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;

    #[derive(Debug, Parser)]
    struct AlertsLine {
        #[command(subcommand)]
        command: AlertsCommand,
    }

    fn parsed(line: &[&str]) -> Result<AlertsCommand, String> {
        let words: Vec<&str> = std::iter::once("alerts").chain(line.iter().copied()).collect();
        AlertsLine::try_parse_from(words).map(|line| line.command).map_err(|error| error.to_string())
    }

    #[test]
    fn the_end_of_shelving_keeps_its_time_of_day() {
        let until = |text: &str| match parsed(&["shelve", "4", "--until", text]) {
            Ok(AlertsCommand::Shelve(args)) => args.until.map(|until| until.to_string()),
            _ => None,
        };
        assert_eq!(until("2026-09-01").as_deref(), Some("2026-09-01T00:00:00Z"));
        assert_eq!(until("2027-01-01T06:00").as_deref(), Some("2027-01-01T06:00:00Z"));
        assert_eq!(until("2026-09-01T06:00:00+02:00").as_deref(), Some("2026-09-01T04:00:00Z"));
        assert_eq!((until("tomorrow"), until("2026-13-01")), (None, None));
    }

    #[test]
    fn the_end_of_shelving_is_asked_for_with_both_ways_to_say_it() {
        let refused = |line: &[&str]| parsed(line).map(drop).expect_err("a fault");
        let neither = refused(&["shelve", "4"]);
        assert!(neither.contains("--until <TIME>") && neither.contains("--days <N>"), "{neither}");
        assert!(refused(&["shelve", "4", "--until", "2099-01-07", "--days", "3"]).contains("cannot be used"));
        for days in ["-3", "0", "3651"] {
            let said = refused(&["shelve", "4", "--days", days]);
            assert!(said.contains("1..=3650") && !said.contains("-- "), "{said}");
        }
    }

    #[test]
    fn a_name_or_reason_of_spaces_is_refused() {
        for option in ["--by", "--why"] {
            let refused = parsed(&["ack", "4", option, " "]).map(drop);
            assert!(refused.is_err_and(|words| words.contains("it is empty")), "{option}");
        }
        match parsed(&["ack", "4", "--by", " mueller "]) {
            Ok(AlertsCommand::Ack(args)) => assert_eq!(args.by.as_deref(), Some("mueller")),
            other => panic!("{other:?}"),
        }
    }
}
