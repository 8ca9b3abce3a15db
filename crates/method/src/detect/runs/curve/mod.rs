//! Friction of a joint over the cycles of a run: a curve that falls while the joint warms. The modules find the cause
//! of its difference from the curve of the joint's first runs, even if only several runs together show it.

pub(super) mod template;
pub(super) mod hypothesis;
pub(super) mod within_run;
pub(super) mod causes;
pub(super) mod points;
pub(super) mod usual;
pub(super) mod run_cause;
pub(super) mod warm_up_jump;
