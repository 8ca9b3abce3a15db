//! Friction of a joint over the cycles of a run: a curve that falls while the joint warms. Which cause explains how it
//! differs from the curve of the joint's first runs, also where only several runs together show it.

pub(super) mod template;
pub(super) mod hypothesis;
pub(super) mod within_run;
pub(super) mod causes;
pub(super) mod points;
pub(super) mod usual;
pub(super) mod run_cause;
pub(super) mod warm_up_jump;
