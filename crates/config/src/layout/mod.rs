//! Layouts of exports.

pub(super) mod column;
pub(super) mod column_names;
pub(super) mod stage_source;
pub(super) mod temperature;
pub(super) mod text_format;
pub(super) mod channels;
pub(super) mod layout_time;
pub(super) mod layout_file;
pub(super) mod parts;
