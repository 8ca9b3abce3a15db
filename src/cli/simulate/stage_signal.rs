//! Stage signals that the simulator can write in place of the native one.

use clap::ValueEnum;

use crate::cli::context::CliError;
use armwatch_config::{Column, Config, FromMotion, Layout, OneHot, StageLevels, StageSource, StageWords};
use armwatch_model::run::Stage;
use armwatch_model::run::stage_rule::LevelSettings;

/// How a simulated export tells its stages.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(in crate::cli) enum StageSignalArg {
    /// Whole numbers in the column stage: 0, 1, 2, 3
    Integer,
    /// Words in the column stage: IDLE, EXC, FRIC, WARM
    Text,
    /// One column of 0 and 1 per stage: exc, fric, warm
    OneHot,
    /// Volts with noise and spikes in the column stage: 0, 2.5, 5, 7.5
    Analogue,
    /// No signal: no columns for stage, cycle, joint and level
    None,
}

impl StageSignalArg {
    /// The native layout with this stage signal.
    pub(in crate::cli) fn layout(self) -> Result<Layout, CliError> {
        let shipped = Config::shipped()?;
        let native = shipped.fleet.first().map(|entry| Layout::clone(&entry.layout));
        let native =
            native.ok_or_else(|| CliError::Internal("the shipped configuration has no layout".into()))?;
        let column = |name: &str| Column::Name(name.into());
        let stage = match self {
            Self::Integer => native.stage.clone(),
            Self::Text => StageSource::Words(StageWords {
                column: column("stage"),
                words: [
                    ("IDLE", Stage::Between),
                    ("EXC", Stage::Excitation),
                    ("FRIC", Stage::Friction),
                    ("WARM", Stage::Warming),
                ]
                .map(|(word, stage)| (word.to_owned(), stage))
                .into(),
            }),
            Self::OneHot => StageSource::OneHot(OneHot {
                columns: vec![
                    (Stage::Excitation, column("exc")),
                    (Stage::Friction, column("fric")),
                    (Stage::Warming, column("warm")),
                ],
            }),
            Self::Analogue => StageSource::Levels(StageLevels {
                column: column("stage"),
                settings: LevelSettings {
                    ranges: vec![
                        (Stage::Between, [-0.5, 0.5]),
                        (Stage::Excitation, [2.0, 3.0]),
                        (Stage::Friction, [4.5, 5.5]),
                        (Stage::Warming, [7.0, 8.0]),
                    ],
                    hysteresis: 0.2,
                    debounce: 0.1,
                },
            }),
            Self::None => {
                let none = (None, None, None);
                let (cycle, friction_joint, friction_level) = none;
                let stage = StageSource::Motion(FromMotion);
                return Ok(Layout { stage, cycle, friction_joint, friction_level, ..native });
            }
        };
        Ok(Layout { stage, ..native })
    }
}
