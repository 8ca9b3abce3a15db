-- Tables of a new database, in the SQL of SQLite. `crates/store/src/schema/dialect.rs` makes PostgreSQL's from it.
--
-- A flag is an INTEGER with `CHECK (name IN (0, 1))`. A time is a number of microseconds since 1970, UTC. A column
-- `*_text` repeats a time in the form of the views, and the database writes it.

-- Version of the tables, and a hash of indexes, triggers and views, which are made again when it differs.
CREATE TABLE schema_version (
    only_one INTEGER PRIMARY KEY CHECK (only_one = 1),
    version INTEGER NOT NULL,
    derived TEXT NOT NULL
) STRICT;

-- The arms that recordings are of.

CREATE TABLE robot (
    robot_id INTEGER PRIMARY KEY,
    name TEXT NOT NULL UNIQUE,
    history INTEGER NOT NULL DEFAULT 0,
    concluded INTEGER NOT NULL DEFAULT 0,
    -- Changes of tests before the latest one, and of work on the robot.
    past_revision INTEGER NOT NULL DEFAULT 0,
    expected_by TEXT,
    watched INTEGER NOT NULL DEFAULT 0 CHECK (watched IN (0, 1)),
    overdue INTEGER NOT NULL DEFAULT 0 CHECK (overdue IN (0, 1)),
    peers_compared INTEGER NOT NULL DEFAULT 0
) STRICT;

CREATE TABLE robot_model (
    robot_model_id INTEGER PRIMARY KEY,
    name TEXT NOT NULL,
    -- BLAKE3 of joint kinds, modified Denavit-Hartenberg parameters and gravity.
    description_hash BLOB NOT NULL CHECK (length(description_hash) = 32),
    UNIQUE (name, description_hash)
) STRICT;

CREATE TABLE model_parameter (
    model_parameter_id INTEGER PRIMARY KEY,
    robot_model_id INTEGER NOT NULL REFERENCES robot_model ON DELETE CASCADE,
    joint INTEGER NOT NULL CHECK (joint >= 1),
    name TEXT NOT NULL,
    unit TEXT NOT NULL,
    -- Sum of the standard parameters that the base parameter combines; NULL until described.
    grouping TEXT,
    UNIQUE (robot_model_id, joint, name)
) STRICT;

-- Programs that write, and the work of each.

-- A program that may write, from its start to its end. Its number is the epoch of its lease.
CREATE TABLE host_session (
    host_session_id INTEGER PRIMARY KEY AUTOINCREMENT,
    -- The name that --host or [cluster] gives; empty without one.
    host TEXT NOT NULL,
    kind TEXT NOT NULL CHECK (kind IN ('daemon', 'command')),
    version TEXT NOT NULL,
    started_at INTEGER NOT NULL,
    seen_at INTEGER NOT NULL,
    -- When the lease ends unless it is renewed.
    alive_until INTEGER NOT NULL,
    ended_at INTEGER,
    end_reason TEXT CHECK (end_reason IN ('stopped', 'restarted', 'lease_ended')),
    started_at_text TEXT GENERATED ALWAYS AS (time_text(started_at)) STORED,
    seen_at_text TEXT GENERATED ALWAYS AS (time_text(seen_at)) STORED,
    CHECK ((ended_at IS NULL) = (end_reason IS NULL))
) STRICT;

-- Work that one session has claimed.
CREATE TABLE claim (
    kind TEXT NOT NULL CHECK (kind IN ('export', 'run', 'robot', 'route')),
    subject TEXT NOT NULL,
    host_session_id INTEGER NOT NULL REFERENCES host_session ON DELETE CASCADE,
    claimed_at INTEGER NOT NULL,
    PRIMARY KEY (kind, subject)
) STRICT, WITHOUT ROWID;

-- Watched folders whose disk or file server does not answer the daemon of a host.
CREATE TABLE unanswered_folder (
    -- The name that --host or [cluster] gives; empty without one.
    host TEXT NOT NULL,
    folder TEXT NOT NULL,
    -- When the daemon last looked into it, microseconds since 1970; NULL if not since its start.
    looked_at INTEGER,
    PRIMARY KEY (host, folder)
) STRICT, WITHOUT ROWID;

-- Work whose attempts are counted before they begin, so that an attempt that ends the program is not repeated for ever.
CREATE TABLE attempt (
    work TEXT NOT NULL CHECK (work IN ('program', 'export', 'conclusion', 'delivery')),
    -- Host, path, robot or message.
    subject TEXT NOT NULL,
    attempts INTEGER NOT NULL CHECK (attempts >= 1),
    -- The process that made the latest attempt, as long as it may still be at it.
    process INTEGER,
    -- The program that made them. Another version starts the count again.
    version TEXT NOT NULL,
    -- The file to read. Another file, or more stored cycles of it, start the count again.
    inode INTEGER NOT NULL DEFAULT 0,
    bytes INTEGER NOT NULL DEFAULT 0,
    cycles INTEGER NOT NULL DEFAULT 0,
    PRIMARY KEY (work, subject)
) STRICT, WITHOUT ROWID;

-- Exports and how they were read.

CREATE TABLE run (
    -- AUTOINCREMENT: the number of a discarded run is never given to another one.
    run_id INTEGER PRIMARY KEY AUTOINCREMENT,
    robot_id INTEGER NOT NULL REFERENCES robot ON DELETE CASCADE,
    model TEXT NOT NULL,
    robot_model_id INTEGER REFERENCES robot_model,
    started_at INTEGER NOT NULL,
    source_name TEXT NOT NULL,
    source_path TEXT NOT NULL,
    source_bytes INTEGER NOT NULL CHECK (source_bytes >= 0),
    -- The same bytes under another name are the same run. An export with the columns of several robots has a run of each.
    content_hash BLOB NOT NULL CHECK (length(content_hash) = 32),
    rows INTEGER CHECK (rows >= 0),
    sample_rate_hz REAL,
    -- Mark of progress: moves in the transaction that stores a cycle, so a reader that starts again
    -- knows where to go on.
    cycles_stored INTEGER NOT NULL DEFAULT 0 CHECK (cycles_stored >= 0),
    cycles_total INTEGER,
    status TEXT NOT NULL CHECK (status IN ('streaming', 'complete', 'quarantined')),
    reason TEXT,
    -- Place in the export where reading stopped.
    reason_line INTEGER,
    reason_column TEXT,
    -- Wall time. No view has it, so that two databases with the same exports have the same views.
    ingested_at INTEGER NOT NULL DEFAULT (CAST(unixepoch('subsec') * 1000000 AS INTEGER)),
    growing INTEGER NOT NULL DEFAULT 0 CHECK (growing IN (0, 1)),
    prefix_bytes INTEGER CHECK (prefix_bytes >= 0),
    prefix_hash BLOB CHECK (length(prefix_hash) = 32),
    replaces_run_id INTEGER REFERENCES run ON DELETE SET NULL,
    superseded_by_run_id INTEGER REFERENCES run ON DELETE SET NULL,
    device INTEGER,
    inode INTEGER,
    kind TEXT NOT NULL DEFAULT 'test' CHECK (kind IN ('test', 'production')),
    retry_asked_at INTEGER,
    made_with BLOB CHECK (length(made_with) = 32),
    first_rows BLOB CHECK (length(first_rows) = 32),
    rows_skipped INTEGER CHECK (rows_skipped >= 0),
    figures_hash BLOB CHECK (length(figures_hash) = 32),
    started_at_text TEXT GENERATED ALWAYS AS (time_text(started_at)) STORED,
    retry_asked_at_text TEXT GENERATED ALWAYS AS (time_text(retry_asked_at)) STORED,
    host_session_id INTEGER REFERENCES host_session,
    -- Such a run is its own successor: whatever leaves out superseded runs leaves it out. With 'arrival_order' it takes part
    -- at the time of its arrival, and only to open alarms.
    set_aside TEXT CHECK (set_aside IN ('person', 'implausible_date', 'arrival_order')),
    -- Reason why its start cannot be right; NULL if it can.
    date_problem TEXT,
    -- The recorded start, if a person has corrected or confirmed it, or the arrival stands for it.
    recorded_start INTEGER,
    recorded_start_text TEXT,
    -- Changes of its figures.
    revision INTEGER NOT NULL DEFAULT 0,
    UNIQUE (content_hash, robot_id),
    CHECK ((status = 'quarantined') = (reason IS NOT NULL)),
    CHECK (status <> 'complete' OR (rows IS NOT NULL AND cycles_total = cycles_stored))
) STRICT;

CREATE TABLE source_file (
    path TEXT PRIMARY KEY,
    bytes INTEGER NOT NULL,
    modified INTEGER NOT NULL,
    run_id INTEGER NOT NULL REFERENCES run ON DELETE CASCADE
) STRICT, WITHOUT ROWID;

CREATE TABLE resume_point (
    run_id INTEGER PRIMARY KEY REFERENCES run ON DELETE CASCADE,
    cycles INTEGER NOT NULL CHECK (cycles >= 1),
    byte INTEGER NOT NULL CHECK (byte >= 0),
    state BLOB NOT NULL
) STRICT;

CREATE TABLE fault (
    fault_id INTEGER PRIMARY KEY,
    run_id INTEGER NOT NULL REFERENCES run ON DELETE CASCADE,
    -- Without place and remedy. If there is a value, it follows after "value is ".
    problem TEXT NOT NULL,
    -- In the decompressed file: lines from 1, bytes from 0, of the cell or else of the line.
    line INTEGER CHECK (line >= 1),
    column_name TEXT,
    byte INTEGER CHECK (byte >= 0),
    value TEXT,
    remedy TEXT NOT NULL,
    -- Whole cycles before the fault, which were stored.
    cycles_stored INTEGER NOT NULL CHECK (cycles_stored >= 0),
    -- Attempts that found just this, one after the other, and when the first and the last did.
    tries INTEGER NOT NULL DEFAULT 1 CHECK (tries >= 1),
    first_at INTEGER NOT NULL DEFAULT (CAST(unixepoch('subsec') * 1000000 AS INTEGER)),
    last_at INTEGER NOT NULL DEFAULT (CAST(unixepoch('subsec') * 1000000 AS INTEGER)),
    first_at_text TEXT GENERATED ALWAYS AS (time_text(first_at)) STORED,
    last_at_text TEXT GENERATED ALWAYS AS (time_text(last_at)) STORED
) STRICT;

CREATE TABLE dismissal (
    dismissal_id INTEGER PRIMARY KEY,
    fault_id INTEGER NOT NULL REFERENCES fault ON DELETE CASCADE,
    dismissed_at INTEGER NOT NULL DEFAULT (CAST(unixepoch('subsec') * 1000000 AS INTEGER)),
    dismissed_by TEXT NOT NULL,
    reason TEXT NOT NULL,
    withdrawn_at INTEGER,
    dismissed_at_text TEXT GENERATED ALWAYS AS (time_text(dismissed_at)) STORED
) STRICT;

-- Growing files that cannot be read on before they have settled or are corrected.
CREATE TABLE blocked_file (
    path TEXT PRIMARY KEY,
    run_id INTEGER REFERENCES run ON DELETE CASCADE,
    -- The robot that the name says, which may have no run yet.
    robot TEXT,
    source_name TEXT NOT NULL,
    line INTEGER CHECK (line >= 1),
    problem TEXT NOT NULL,
    remedy TEXT NOT NULL,
    blocked_at TEXT NOT NULL DEFAULT (strftime('%Y-%m-%dT%H:%M:%fZ', 'now'))
) STRICT, WITHOUT ROWID;

-- Results of a cycle.

CREATE TABLE cycle (
    cycle_id INTEGER PRIMARY KEY,
    run_id INTEGER NOT NULL REFERENCES run ON DELETE CASCADE,
    number INTEGER NOT NULL CHECK (number >= 1),
    started_at INTEGER NOT NULL,
    duration_s REAL NOT NULL,
    rows INTEGER NOT NULL CHECK (rows >= 0),
    sample_rate_hz REAL,
    cutoff_hz REAL,
    -- refused: the cycle gave no parameters, for the stated reason.
    status TEXT NOT NULL CHECK (status IN ('complete', 'refused')),
    reason TEXT,
    -- Remarks about the data for the user, one sentence per line.
    remarks TEXT,
    samples INTEGER,
    condition_number REAL,
    scaled_condition_number REAL,
    residual_std_nm REAL,
    estimator TEXT NOT NULL DEFAULT 'ordinary' CHECK (estimator IN ('ordinary', 'weighted', 'huber')),
    mean_speeds_rad_s TEXT CHECK (mean_speeds_rad_s IS NULL OR json_valid(mean_speeds_rad_s)),
    error_basis TEXT CHECK (error_basis IN ('blocks', 'independent_rows')),
    estimator_wanted TEXT CHECK (estimator_wanted IN ('ordinary', 'weighted', 'huber')),
    estimator_reason TEXT,
    doubtful INTEGER NOT NULL DEFAULT 0 CHECK (doubtful IN (0, 1)),
    cut_by_end INTEGER NOT NULL DEFAULT 0 CHECK (cut_by_end IN (0, 1)),
    started_at_text TEXT GENERATED ALWAYS AS (time_text(started_at)) STORED,
    factors_gone TEXT CHECK (factors_gone IN ('joined', 'removed')),
    UNIQUE (run_id, number),
    CHECK ((status = 'refused') = (reason IS NOT NULL))
) STRICT;

CREATE TABLE cycle_parameter (
    cycle_id INTEGER NOT NULL REFERENCES cycle ON DELETE CASCADE,
    model_parameter_id INTEGER NOT NULL REFERENCES model_parameter,
    value REAL NOT NULL,
    std_error REAL,
    degrees_of_freedom REAL,
    half_width_95 REAL,
    PRIMARY KEY (cycle_id, model_parameter_id)
) STRICT, WITHOUT ROWID;

CREATE TABLE joint_residual (
    cycle_id INTEGER NOT NULL REFERENCES cycle ON DELETE CASCADE,
    joint INTEGER NOT NULL CHECK (joint >= 1),
    residual_std_nm REAL,
    -- Independent rows over the joint's rows, for errors from factors alone. Above 1 if the noise is less at the
    -- frequencies of the motion than above them.
    independent_share REAL CHECK (independent_share > 0),
    PRIMARY KEY (cycle_id, joint)
) STRICT, WITHOUT ROWID;

-- Noise in the excitation stage of cycles with parameters.
CREATE TABLE channel_noise (
    cycle_id INTEGER NOT NULL REFERENCES cycle ON DELETE CASCADE,
    joint INTEGER NOT NULL CHECK (joint >= 1),
    noise_nm REAL NOT NULL,
    relative_noise REAL NOT NULL,
    PRIMARY KEY (cycle_id, joint)
) STRICT, WITHOUT ROWID;

CREATE TABLE cycle_temperature (
    cycle_id INTEGER NOT NULL REFERENCES cycle ON DELETE CASCADE,
    joint INTEGER NOT NULL CHECK (joint >= 0),
    temperature_degc REAL NOT NULL,
    PRIMARY KEY (cycle_id, joint)
) STRICT, WITHOUT ROWID;

CREATE TABLE cycle_refusal (
    cycle_id INTEGER NOT NULL REFERENCES cycle ON DELETE CASCADE,
    number INTEGER NOT NULL CHECK (number >= 1),
    -- Name of the check, such as stuck_channel; earlier for cycles stored before this table was.
    finding TEXT NOT NULL,
    channel TEXT NOT NULL CHECK (channel IN ('position', 'velocity', 'torque', 'time', 'rows', 'motion', 'model')),
    -- NULL: the whole arm's.
    joint INTEGER CHECK (joint >= 1),
    sentence TEXT NOT NULL,
    PRIMARY KEY (cycle_id, number)
) STRICT, WITHOUT ROWID;

CREATE TABLE torque_rmsd (
    torque_rmsd_id INTEGER PRIMARY KEY,
    cycle_id INTEGER NOT NULL REFERENCES cycle ON DELETE CASCADE,
    joint INTEGER NOT NULL CHECK (joint >= 1),
    stage TEXT NOT NULL CHECK (stage IN ('excitation', 'friction', 'warming', 'all')),
    -- self: the cycle's own parameters; cross: those of the reference run.
    verification TEXT NOT NULL CHECK (verification IN ('self', 'cross')),
    reference_run_id INTEGER REFERENCES run ON DELETE CASCADE,
    rmsd_nm REAL,
    relative_rmsd REAL,
    moving_rmsd_nm REAL,
    moving_relative_rmsd REAL,
    samples INTEGER NOT NULL CHECK (samples >= 0),
    moving_samples INTEGER NOT NULL CHECK (moving_samples >= 0),
    estimator TEXT CHECK (estimator IN ('ordinary', 'weighted', 'huber')),
    CHECK ((verification = 'cross') = (reference_run_id IS NOT NULL))
) STRICT;

CREATE TABLE warming_rmsd (
    cycle_id INTEGER NOT NULL REFERENCES cycle ON DELETE CASCADE,
    joint INTEGER NOT NULL CHECK (joint >= 1),
    part TEXT NOT NULL CHECK (part IN ('start', 'end')),
    rmsd_nm REAL,
    relative_rmsd REAL,
    moving_rmsd_nm REAL,
    moving_relative_rmsd REAL,
    samples INTEGER NOT NULL CHECK (samples >= 0),
    moving_samples INTEGER NOT NULL CHECK (moving_samples >= 0),
    estimator TEXT CHECK (estimator IN ('ordinary', 'weighted', 'huber')),
    PRIMARY KEY (cycle_id, joint, part)
) STRICT, WITHOUT ROWID;

CREATE TABLE friction_point (
    cycle_id INTEGER NOT NULL REFERENCES cycle ON DELETE CASCADE,
    speed_fraction REAL NOT NULL,
    number INTEGER NOT NULL,
    joint INTEGER NOT NULL CHECK (joint >= 1),
    -- Since the start of the recording.
    time_s REAL NOT NULL,
    speed_rad_s REAL NOT NULL,
    direction INTEGER NOT NULL CHECK (direction IN (-1, 1)),
    torque_nm REAL NOT NULL,
    std_nm REAL,
    samples INTEGER NOT NULL CHECK (samples >= 0),
    -- How the load of gravity was subtracted.
    gravity TEXT NOT NULL CHECK (gravity IN ('axis_vertical', 'fitted', 'model')),
    -- Where friction depends on load: mean magnitude of the torque that the gear carries, and friction per carried torque.
    load_nm REAL,
    load_friction REAL,
    PRIMARY KEY (cycle_id, speed_fraction, number)
) STRICT, WITHOUT ROWID;

CREATE TABLE cycle_friction_level (
    cycle_id INTEGER NOT NULL REFERENCES cycle ON DELETE CASCADE,
    joint INTEGER NOT NULL CHECK (joint >= 1),
    -- Mean time of the points since the start of the recording.
    minute REAL NOT NULL,
    -- Mean over the levels of the natural logarithm of half the difference between both directions.
    ln_torque REAL NOT NULL,
    -- Mean over the levels of half the sum of both directions.
    offset_nm REAL NOT NULL,
    levels INTEGER NOT NULL CHECK (levels >= 1),
    -- Mean over the levels.
    speed_fraction REAL NOT NULL,
    PRIMARY KEY (cycle_id, joint)
) STRICT, WITHOUT ROWID;

CREATE TABLE friction_speed_fit (
    friction_speed_fit_id INTEGER PRIMARY KEY,
    cycle_id INTEGER NOT NULL REFERENCES cycle ON DELETE CASCADE,
    joint INTEGER NOT NULL CHECK (joint >= 1),
    direction INTEGER NOT NULL CHECK (direction IN (-1, 1)),
    model TEXT NOT NULL CHECK (model IN ('coulomb', 'coulomb_viscous', 'power_law', 'stribeck', 'polynomial')),
    slowest_rad_s REAL NOT NULL,
    fastest_rad_s REAL NOT NULL,
    rmsd_nm REAL,
    reduced_chi_square REAL,
    points INTEGER NOT NULL CHECK (points >= 0),
    asymmetry_nm REAL,
    asymmetry_std_error_nm REAL,
    UNIQUE (cycle_id, joint, direction)
) STRICT;

CREATE TABLE friction_speed_coefficient (
    friction_speed_fit_id INTEGER NOT NULL REFERENCES friction_speed_fit ON DELETE CASCADE,
    name TEXT NOT NULL,
    value REAL NOT NULL,
    std_error REAL,
    -- Held at zero, since the data alone would have friction drive the joint.
    at_bound INTEGER NOT NULL CHECK (at_bound IN (0, 1)),
    PRIMARY KEY (friction_speed_fit_id, name)
) STRICT, WITHOUT ROWID;

-- Factors. They suffice to estimate a cycle again.

CREATE TABLE factor_layout (
    factor_layout_id INTEGER PRIMARY KEY,
    robot_model_id INTEGER NOT NULL REFERENCES robot_model ON DELETE CASCADE,
    -- JSON: for each joint, from the first, the model_parameter_id of each column.
    columns TEXT NOT NULL CHECK (json_valid(columns)),
    UNIQUE (robot_model_id, columns)
) STRICT;

CREATE TABLE cycle_factor_layout (
    cycle_id INTEGER PRIMARY KEY REFERENCES cycle ON DELETE CASCADE,
    factor_layout_id INTEGER NOT NULL REFERENCES factor_layout
) STRICT;

CREATE TABLE torque_factor (
    torque_factor_id INTEGER PRIMARY KEY,
    cycle_id INTEGER NOT NULL REFERENCES cycle ON DELETE CASCADE,
    joint INTEGER NOT NULL CHECK (joint >= 1),
    stage TEXT NOT NULL CHECK (stage IN ('excitation', 'friction', 'warming', 'between')),
    -- moving: at the joint's low-speed threshold or faster.
    motion TEXT NOT NULL CHECK (motion IN ('moving', 'slow')),
    rows INTEGER NOT NULL CHECK (rows >= 1),
    -- Upper triangle, column after column, 8-byte little-endian floats; the last column is the torque.
    -- Last, so that the other columns are read without its overflow pages.
    factor BLOB NOT NULL,
    UNIQUE (cycle_id, stage, motion, joint)
) STRICT;

CREATE TABLE log_factor (
    log_factor_id INTEGER PRIMARY KEY,
    run_id INTEGER NOT NULL REFERENCES run ON DELETE CASCADE,
    factor_layout_id INTEGER NOT NULL REFERENCES factor_layout,
    joint INTEGER NOT NULL CHECK (joint >= 1),
    stage TEXT NOT NULL CHECK (stage IN ('excitation', 'friction', 'warming', 'between')),
    motion TEXT NOT NULL CHECK (motion IN ('moving', 'slow')),
    rows INTEGER NOT NULL CHECK (rows >= 1),
    factor BLOB NOT NULL,
    UNIQUE (run_id, factor_layout_id, stage, motion, joint)
) STRICT;

-- Results of a run.

CREATE TABLE warmup_fit (
    warmup_fit_id INTEGER PRIMARY KEY,
    robot_id INTEGER NOT NULL REFERENCES robot ON DELETE CASCADE,
    run_id INTEGER REFERENCES run ON DELETE CASCADE,
    joint INTEGER NOT NULL CHECK (joint >= 1),
    speed_fraction REAL NOT NULL,
    model TEXT NOT NULL CHECK (model IN ('double', 'single', 'constant')),
    a_nm REAL NOT NULL,
    a_std_error_nm REAL,
    b_nm REAL,
    b_std_error_nm REAL,
    t1_min REAL,
    t1_std_error_min REAL,
    c_nm REAL,
    c_std_error_nm REAL,
    t2_min REAL,
    t2_std_error_min REAL,
    rmsd_nm REAL,
    samples INTEGER NOT NULL CHECK (samples >= 0),
    first_min REAL,
    last_min REAL,
    a_extrapolated INTEGER CHECK (a_extrapolated IN (0, 1)),
    c_first_nm REAL,
    c_first_std_error_nm REAL,
    t2_max_min REAL,
    CHECK ((model = 'constant') = (b_nm IS NULL)),
    CHECK ((model = 'double') = (c_nm IS NOT NULL)),
    CHECK ((b_nm IS NULL) = (t1_min IS NULL) AND (c_nm IS NULL) = (t2_min IS NULL)),
    CHECK (t2_min IS NULL OR t1_min > t2_min)
) STRICT;

CREATE TABLE parameter_statistic (
    run_id INTEGER NOT NULL REFERENCES run ON DELETE CASCADE,
    model_parameter_id INTEGER NOT NULL REFERENCES model_parameter,
    "window" TEXT NOT NULL CHECK ("window" IN ('all', 'after_5')),
    mean REAL NOT NULL,
    min REAL NOT NULL,
    max REAL NOT NULL,
    -- (max - min) / |max|
    d_mm REAL,
    -- |last - first| / |first|
    d_se REAL,
    sdv REAL,
    cycles INTEGER NOT NULL CHECK (cycles >= 1),
    PRIMARY KEY (run_id, model_parameter_id, "window")
) STRICT, WITHOUT ROWID;

CREATE TABLE run_joint_summary (
    run_id INTEGER NOT NULL REFERENCES run ON DELETE CASCADE,
    joint INTEGER NOT NULL CHECK (joint >= 1),
    warm_friction_nm REAL,
    warm_friction_std_error_nm REAL,
    -- Mean time of the points: only runs at equal temperature are compared.
    warm_minute REAL,
    warm_speed_fraction REAL,
    -- Median over cycles of the moving relative RMSD of the excitation stage.
    relative_rmsd REAL,
    -- How much that RMSD swings from cycle to cycle, and over how many cycles.
    rmsd_swing REAL,
    rmsd_swing_cycles INTEGER,
    estimator TEXT CHECK (estimator IN ('ordinary', 'weighted', 'huber')),
    excitation_friction_nm REAL,
    excitation_friction_std_error_nm REAL,
    excitation_minute REAL,
    excitation_speed_fraction REAL,
    -- Median over the cycles of a test.
    relative_noise REAL,
    -- RMS of the torque while the joint moves in the excitation: median over the cycles of a test.
    torque_rms_nm REAL,
    -- Friction of the excitation at half its speed.
    half_speed_friction_nm REAL,
    half_speed_std_error_nm REAL,
    PRIMARY KEY (run_id, joint)
) STRICT, WITHOUT ROWID;

CREATE TABLE channel_response (
    run_id INTEGER PRIMARY KEY REFERENCES run ON DELETE CASCADE,
    parameters TEXT NOT NULL,
    numbers BLOB NOT NULL
) STRICT;

-- Logs of production against the tests before them.

CREATE TABLE production_check (
    cycle_id INTEGER NOT NULL REFERENCES cycle ON DELETE CASCADE,
    joint INTEGER NOT NULL CHECK (joint >= 1),
    reference_run_id INTEGER NOT NULL REFERENCES run ON DELETE CASCADE,
    rmsd_nm REAL,
    relative_rmsd REAL,
    samples INTEGER NOT NULL CHECK (samples >= 0),
    moving_rmsd_nm REAL,
    moving_relative_rmsd REAL,
    moving_samples INTEGER NOT NULL CHECK (moving_samples >= 0),
    friction_excess REAL,
    friction_share REAL,
    settled INTEGER NOT NULL DEFAULT 0 CHECK (settled IN (0, 1)),
    estimator TEXT NOT NULL DEFAULT 'ordinary' CHECK (estimator IN ('ordinary', 'weighted', 'huber')),
    PRIMARY KEY (cycle_id, joint)
) STRICT, WITHOUT ROWID;

CREATE TABLE production_summary (
    run_id INTEGER NOT NULL REFERENCES run ON DELETE CASCADE,
    reference_run_id INTEGER NOT NULL REFERENCES run ON DELETE CASCADE,
    joint INTEGER NOT NULL CHECK (joint >= 1),
    windows INTEGER NOT NULL CHECK (windows >= 1),
    relative_rmsd REAL NOT NULL,
    friction_excess REAL NOT NULL,
    friction_share REAL NOT NULL,
    PRIMARY KEY (run_id, reference_run_id, joint)
) STRICT, WITHOUT ROWID;

CREATE TABLE window_evidence (
    cycle_id INTEGER PRIMARY KEY REFERENCES cycle ON DELETE CASCADE,
    numbers BLOB NOT NULL
) STRICT;

CREATE TABLE log_evidence (
    run_id INTEGER NOT NULL REFERENCES run ON DELETE CASCADE,
    reference_run_id INTEGER NOT NULL REFERENCES run ON DELETE CASCADE,
    numbers BLOB NOT NULL,
    PRIMARY KEY (run_id, reference_run_id)
) STRICT, WITHOUT ROWID;

-- Estimates that a person keeps.

CREATE TABLE parameter_set (
    parameter_set_id INTEGER PRIMARY KEY,
    name TEXT NOT NULL UNIQUE,
    robot_model_id INTEGER NOT NULL REFERENCES robot_model,
    samples INTEGER NOT NULL CHECK (samples >= 1),
    condition_number REAL,
    scaled_condition_number REAL,
    residual_std_nm REAL,
    -- Wall time.
    saved_at INTEGER NOT NULL DEFAULT (CAST(unixepoch('subsec') * 1000000 AS INTEGER)),
    estimator TEXT NOT NULL DEFAULT 'ordinary'
        CHECK (estimator IN ('ordinary', 'weighted', 'per-joint', 'huber', 'prior')),
    error_basis TEXT NOT NULL DEFAULT 'independent_rows' CHECK (error_basis IN ('cycles', 'independent_rows'))
) STRICT;

CREATE TABLE parameter_set_value (
    parameter_set_id INTEGER NOT NULL REFERENCES parameter_set ON DELETE CASCADE,
    model_parameter_id INTEGER NOT NULL REFERENCES model_parameter,
    value REAL NOT NULL,
    std_error REAL,
    degrees_of_freedom REAL,
    PRIMARY KEY (parameter_set_id, model_parameter_id)
) STRICT, WITHOUT ROWID;

CREATE TABLE parameter_set_source (
    parameter_set_id INTEGER NOT NULL REFERENCES parameter_set ON DELETE CASCADE,
    run_id INTEGER NOT NULL,
    cycle INTEGER NOT NULL,
    robot TEXT NOT NULL,
    PRIMARY KEY (parameter_set_id, run_id, cycle)
) STRICT, WITHOUT ROWID;

CREATE TABLE reestimate (
    reestimate_id INTEGER PRIMARY KEY,
    name TEXT NOT NULL UNIQUE,
    robot_model_id INTEGER NOT NULL REFERENCES robot_model,
    estimator TEXT NOT NULL CHECK (estimator IN ('ordinary', 'weighted', 'per-joint', 'huber', 'prior')),
    -- Wall time.
    saved_at INTEGER NOT NULL DEFAULT (CAST(unixepoch('subsec') * 1000000 AS INTEGER))
) STRICT;

CREATE TABLE reestimate_cycle (
    reestimate_cycle_id INTEGER PRIMARY KEY,
    reestimate_id INTEGER NOT NULL REFERENCES reestimate ON DELETE CASCADE,
    robot TEXT NOT NULL,
    run_id INTEGER NOT NULL,
    cycle INTEGER NOT NULL,
    -- Why it, or some of its joints, gave no parameters.
    reason TEXT,
    UNIQUE (reestimate_id, run_id, cycle)
) STRICT;

CREATE TABLE reestimate_view (
    reestimate_cycle_id INTEGER NOT NULL REFERENCES reestimate_cycle ON DELETE CASCADE,
    seen_by_joint INTEGER NOT NULL CHECK (seen_by_joint >= 0),
    samples INTEGER NOT NULL CHECK (samples >= 1),
    condition_number REAL,
    scaled_condition_number REAL,
    residual_std_nm REAL,
    PRIMARY KEY (reestimate_cycle_id, seen_by_joint)
) STRICT, WITHOUT ROWID;

CREATE TABLE reestimate_value (
    reestimate_cycle_id INTEGER NOT NULL REFERENCES reestimate_cycle ON DELETE CASCADE,
    seen_by_joint INTEGER NOT NULL CHECK (seen_by_joint >= 0),
    model_parameter_id INTEGER NOT NULL REFERENCES model_parameter,
    value REAL NOT NULL,
    std_error REAL,
    -- Half the width of the 95 % interval: Student's quantile is no function of SQL.
    half_width_95 REAL,
    data_share REAL,
    PRIMARY KEY (reestimate_cycle_id, seen_by_joint, model_parameter_id)
) STRICT, WITHOUT ROWID;

CREATE TABLE reestimate_statistic (
    reestimate_id INTEGER NOT NULL REFERENCES reestimate ON DELETE CASCADE,
    robot TEXT NOT NULL,
    run_id INTEGER NOT NULL,
    seen_by_joint INTEGER NOT NULL CHECK (seen_by_joint >= 0),
    model_parameter_id INTEGER NOT NULL REFERENCES model_parameter,
    "window" TEXT NOT NULL CHECK ("window" IN ('all', 'after_5')),
    mean REAL NOT NULL,
    min REAL NOT NULL,
    max REAL NOT NULL,
    d_mm REAL,
    d_se REAL,
    sdv REAL,
    cycles INTEGER NOT NULL CHECK (cycles >= 1),
    PRIMARY KEY (reestimate_id, run_id, seen_by_joint, model_parameter_id, "window")
) STRICT, WITHOUT ROWID;

-- Friction of a robot over its tests.

CREATE TABLE friction_law (
    robot_id INTEGER NOT NULL REFERENCES robot ON DELETE CASCADE,
    joint INTEGER NOT NULL CHECK (joint >= 1),
    slow_min REAL NOT NULL,
    slow_std_error_min REAL,
    fast_min REAL NOT NULL,
    fast_std_error_min REAL,
    slow_share REAL NOT NULL,
    slow_share_std_error REAL,
    cooling_ratio REAL NOT NULL,
    cooling_ratio_std_error REAL,
    relative_rmsd REAL,
    explained REAL,
    runs INTEGER NOT NULL CHECK (runs >= 0),
    points INTEGER NOT NULL CHECK (points >= 0),
    remarks TEXT,
    -- JSON, row after row: warm friction by level, cold part by level, logarithms of the slow and the fast
    -- time constant in seconds, share of the slow part, logarithm of the cooling ratio.
    covariance TEXT NOT NULL CHECK (json_valid(covariance)),
    thermal_source TEXT NOT NULL DEFAULT 'motion'
        CHECK (thermal_source IN ('motion', 'motor_temperature', 'ambient_and_motion')),
    warm_degc REAL,
    cold_degc REAL,
    curvature REAL,
    curvature_std_error REAL,
    ambient_degc REAL,
    coldness_1_k REAL,
    coldness_std_error_1_k REAL,
    basis BLOB CHECK (length(basis) = 32),
    PRIMARY KEY (robot_id, joint)
) STRICT, WITHOUT ROWID;

CREATE TABLE friction_level (
    robot_id INTEGER NOT NULL,
    joint INTEGER NOT NULL,
    speed_fraction REAL NOT NULL,
    warm_nm REAL NOT NULL,
    warm_std_error_nm REAL,
    cold_nm REAL NOT NULL CHECK (cold_nm >= 0),
    cold_std_error_nm REAL,
    PRIMARY KEY (robot_id, joint, speed_fraction),
    FOREIGN KEY (robot_id, joint) REFERENCES friction_law ON DELETE CASCADE
) STRICT, WITHOUT ROWID;

CREATE TABLE run_friction (
    run_id INTEGER PRIMARY KEY REFERENCES run ON DELETE CASCADE,
    -- BLAKE3 of the sources of its indices: its baselines, the test and the motion before it. Indices of another basis
    -- are computed again. NULL if no joint has a baseline for the test.
    basis BLOB CHECK (length(basis) = 32)
) STRICT;

CREATE TABLE run_friction_points (
    run_id INTEGER NOT NULL REFERENCES run_friction ON DELETE CASCADE,
    joint INTEGER NOT NULL CHECK (joint >= 1),
    points INTEGER NOT NULL CHECK (points >= 0),
    PRIMARY KEY (run_id, joint)
) STRICT, WITHOUT ROWID;

CREATE TABLE run_friction_index (
    run_id INTEGER NOT NULL REFERENCES run ON DELETE CASCADE,
    joint INTEGER NOT NULL CHECK (joint >= 1),
    friction_index REAL NOT NULL,
    friction_index_std_error REAL,
    ambient_coldness REAL NOT NULL,
    ambient_coldness_std_error REAL,
    coldness_at_start REAL NOT NULL,
    points INTEGER NOT NULL CHECK (points >= 0),
    raw_index REAL,
    short_run INTEGER NOT NULL DEFAULT 0 CHECK (short_run IN (0, 1)),
    PRIMARY KEY (run_id, joint)
) STRICT, WITHOUT ROWID;

CREATE TABLE friction_baseline (
    friction_baseline_id INTEGER PRIMARY KEY AUTOINCREMENT,
    robot_id INTEGER NOT NULL REFERENCES robot ON DELETE CASCADE,
    joint INTEGER NOT NULL CHECK (joint >= 1),
    -- Ordinal of the joint's epoch by its first test, from 0.
    epoch INTEGER NOT NULL CHECK (epoch >= 0),
    cause TEXT NOT NULL CHECK (cause IN ('first_test', 'maintenance', 'description')),
    -- No foreign key: the record of a baseline outlives a wrong entry of maintenance.
    maintenance_id INTEGER,
    begins_at INTEGER NOT NULL,
    basis BLOB NOT NULL CHECK (length(basis) = 32),
    -- The held map by level, a JSON array of {"speed_fraction", "warm_nm", "cold_nm"}; NULL if there is none.
    levels TEXT CHECK (json_valid(levels)),
    -- Why there is no map.
    remark TEXT,
    -- Wall time.
    formed_at INTEGER NOT NULL DEFAULT (CAST(unixepoch('subsec') * 1000000 AS INTEGER)),
    replaced_at INTEGER,
    replaced_because TEXT,
    begins_at_text TEXT GENERATED ALWAYS AS (time_text(begins_at)) STORED,
    formed_at_text TEXT GENERATED ALWAYS AS (time_text(formed_at)) STORED,
    replaced_at_text TEXT GENERATED ALWAYS AS (time_text(replaced_at)) STORED,
    CHECK ((replaced_at IS NULL) = (replaced_because IS NULL))
) STRICT;

CREATE TABLE friction_baseline_run (
    friction_baseline_id INTEGER NOT NULL REFERENCES friction_baseline ON DELETE CASCADE,
    run_id INTEGER NOT NULL,
    PRIMARY KEY (friction_baseline_id, run_id)
) STRICT, WITHOUT ROWID;

CREATE TABLE friction_plan (
    robot_id INTEGER PRIMARY KEY REFERENCES robot ON DELETE CASCADE,
    -- The row is valid for this robot.past_revision, this version of the method and this number of tests in a baseline.
    revision INTEGER NOT NULL,
    method INTEGER NOT NULL,
    baseline_runs INTEGER NOT NULL,
    numbers BLOB NOT NULL
) STRICT;

-- Summaries of runs, which follow from the tables above. A row is valid for this run.revision and this version of the method.

CREATE TABLE run_summary (
    run_id INTEGER PRIMARY KEY REFERENCES run ON DELETE CASCADE,
    revision INTEGER NOT NULL,
    method INTEGER NOT NULL,
    numbers BLOB NOT NULL,
    -- Findings in the cycles, each with a hash of its inputs.
    judgements BLOB
) STRICT;

CREATE TABLE run_friction_series (
    robot_id INTEGER NOT NULL REFERENCES robot ON DELETE CASCADE,
    run_id INTEGER NOT NULL REFERENCES run ON DELETE CASCADE,
    speed_fraction REAL NOT NULL,
    revision INTEGER NOT NULL,
    method INTEGER NOT NULL,
    numbers BLOB NOT NULL,
    PRIMARY KEY (run_id, speed_fraction)
) STRICT;

-- The part of a history before a boundary, which conclusions do not judge again.
CREATE TABLE settled_history (
    settled_history_id INTEGER PRIMARY KEY AUTOINCREMENT,
    robot_id INTEGER NOT NULL REFERENCES robot ON DELETE CASCADE,
    kind TEXT NOT NULL CHECK (kind IN ('test', 'production')),
    runs INTEGER NOT NULL CHECK (runs > 0),
    -- Start of the first run behind the boundary, microseconds since 1970.
    boundary_at INTEGER NOT NULL,
    -- Start of the latest run that the row follows from, microseconds since 1970.
    follows_until INTEGER NOT NULL,
    -- Largest key of a run at that time. Runs with larger keys that began before the boundary are not judged.
    latest_run_id INTEGER NOT NULL,
    numbers BLOB NOT NULL,
    UNIQUE (robot_id, kind, runs)
) STRICT;

-- Health, alarms and maintenance.

CREATE TABLE maintenance (
    maintenance_id INTEGER PRIMARY KEY AUTOINCREMENT,
    robot_id INTEGER NOT NULL REFERENCES robot ON DELETE CASCADE,
    -- NULL: the whole arm.
    joint INTEGER CHECK (joint >= 1),
    at INTEGER NOT NULL,
    what TEXT NOT NULL,
    who TEXT,
    recorded_at INTEGER NOT NULL DEFAULT (CAST(unixepoch('subsec') * 1000000 AS INTEGER)),
    at_text TEXT GENERATED ALWAYS AS (time_text(at)) STORED,
    recorded_at_text TEXT GENERATED ALWAYS AS (time_text(recorded_at)) STORED
) STRICT;

-- Planned work: while a window lasts, alarms of its place are in maintenance.
CREATE TABLE maintenance_window (
    maintenance_window_id INTEGER PRIMARY KEY AUTOINCREMENT,
    robot_id INTEGER NOT NULL REFERENCES robot ON DELETE CASCADE,
    -- NULL: the whole arm.
    joint INTEGER CHECK (joint >= 1),
    from_at INTEGER NOT NULL,
    until_at INTEGER NOT NULL CHECK (until_at > from_at),
    what TEXT NOT NULL,
    who TEXT,
    recorded_at INTEGER NOT NULL DEFAULT (CAST(unixepoch('subsec') * 1000000 AS INTEGER)),
    from_at_text TEXT GENERATED ALWAYS AS (time_text(from_at)) STORED,
    until_at_text TEXT GENERATED ALWAYS AS (time_text(until_at)) STORED,
    recorded_at_text TEXT GENERATED ALWAYS AS (time_text(recorded_at)) STORED
) STRICT;

CREATE TABLE joint_health (
    robot_id INTEGER NOT NULL REFERENCES robot ON DELETE CASCADE,
    joint INTEGER NOT NULL CHECK (joint >= 1),
    friction_index REAL,
    friction_quantity TEXT,
    -- compared: the latest test compares with the baseline. learning: no baseline yet. unsettled: one test alone
    -- does not settle it. no_result: the latest test says nothing of the arm.
    knowledge TEXT NOT NULL CHECK (knowledge IN ('compared', 'learning', 'unsettled', 'no_result')),
    reason TEXT,
    last_result_run_id INTEGER REFERENCES run ON DELETE SET NULL,
    trend TEXT CHECK (trend IN ('none', 'rising', 'falling')),
    warning_by TEXT,
    warning_by_lower TEXT,
    warning_by_upper TEXT,
    critical_by TEXT,
    critical_by_lower TEXT,
    critical_by_upper TEXT,
    PRIMARY KEY (robot_id, joint)
) STRICT, WITHOUT ROWID;

CREATE TABLE conclusion_fault (
    robot_id INTEGER PRIMARY KEY REFERENCES robot ON DELETE CASCADE,
    reason TEXT NOT NULL,
    -- Attempts that failed, one after the other, and when the first and the last did.
    tries INTEGER NOT NULL DEFAULT 1 CHECK (tries >= 1),
    first_at INTEGER NOT NULL DEFAULT (CAST(unixepoch('subsec') * 1000000 AS INTEGER)),
    last_at INTEGER NOT NULL DEFAULT (CAST(unixepoch('subsec') * 1000000 AS INTEGER)),
    first_at_text TEXT GENERATED ALWAYS AS (time_text(first_at)) STORED,
    last_at_text TEXT GENERATED ALWAYS AS (time_text(last_at)) STORED
) STRICT;

CREATE TABLE anomaly (
    anomaly_id INTEGER PRIMARY KEY AUTOINCREMENT,
    robot_id INTEGER NOT NULL REFERENCES robot ON DELETE CASCADE,
    joint INTEGER CHECK (joint >= 1),
    -- Names of the lists `AnomalyKind` and `Quantity` of the program.
    kind TEXT NOT NULL,
    quantity TEXT NOT NULL,
    severity TEXT NOT NULL CHECK (severity IN ('info', 'warning', 'critical')),
    score REAL,
    threshold REAL,
    value REAL,
    baseline REAL,
    peak_value REAL,
    peak_score REAL,
    -- An episode outlives its runs: its state is kept until the history is judged again.
    first_run_id INTEGER REFERENCES run ON DELETE SET NULL,
    first_cycle INTEGER CHECK (first_cycle >= 1),
    last_run_id INTEGER REFERENCES run ON DELETE SET NULL,
    first_seen_at INTEGER NOT NULL,
    last_seen_at INTEGER NOT NULL,
    -- The most likely beginning of the change; as first_* if nothing better is known.
    onset_run_id INTEGER REFERENCES run ON DELETE SET NULL,
    onset_cycle INTEGER CHECK (onset_cycle >= 1),
    onset_at INTEGER,
    -- Odds of the named cause against all others together; NULL where causes were not compared.
    odds REAL CHECK (odds >= 0),
    -- Rejected causes as a JSON array of {"cause", "odds"}, the likeliest first.
    alternatives TEXT NOT NULL DEFAULT '[]',
    state TEXT NOT NULL CHECK (state IN ('open', 'acknowledged', 'shelved', 'maintenance', 'resolved', 'false_alarm')),
    -- The person who deals with it.
    assignee TEXT,
    -- Until when it is shelved, or in maintenance by a window.
    shelved_until INTEGER CHECK (state <> 'shelved' OR shelved_until IS NOT NULL),
    message TEXT NOT NULL,
    -- TRUE if later runs no longer show it, in any state.
    ended INTEGER NOT NULL DEFAULT 0 CHECK (ended IN (0, 1)),
    -- Start of the latest run that showed it when a person resolved it: a later one opens it again.
    resolved_seen_at INTEGER CHECK (resolved_seen_at IS NULL OR state = 'resolved'),
    -- TRUE if the history no longer has it. `state` is kept in case it appears again.
    withdrawn INTEGER NOT NULL DEFAULT 0 CHECK (withdrawn IN (0, 1)),
    open_run_id INTEGER REFERENCES run ON DELETE SET NULL,
    first_seen_at_text TEXT GENERATED ALWAYS AS (time_text(first_seen_at)) STORED,
    last_seen_at_text TEXT GENERATED ALWAYS AS (time_text(last_seen_at)) STORED,
    onset_at_text TEXT GENERATED ALWAYS AS (time_text(onset_at)) STORED,
    shelved_until_text TEXT GENERATED ALWAYS AS (time_text(shelved_until)) STORED,
    -- The settlement that it belongs to; NULL while conclusions change it.
    settled_history_id INTEGER REFERENCES settled_history ON DELETE SET NULL
) STRICT;

CREATE TABLE anomaly_event (
    -- AUTOINCREMENT: delivery asks for "newer than this number".
    anomaly_event_id INTEGER PRIMARY KEY AUTOINCREMENT,
    anomaly_id INTEGER NOT NULL REFERENCES anomaly ON DELETE CASCADE,
    -- Wall time, microseconds since 1970.
    at INTEGER NOT NULL DEFAULT (CAST(unixepoch('subsec') * 1000000 AS INTEGER)),
    what TEXT NOT NULL CHECK (what IN ('opened', 'worse', 'corrected', 'ended', 'reopened', 'withdrawn',
        'overdue', 'acknowledged', 'shelved', 'unshelved', 'maintenance', 'resolved', 'false_alarm',
        'commented', 'assigned')),
    -- The anomaly as it was then.
    severity TEXT NOT NULL CHECK (severity IN ('info', 'warning', 'critical')),
    score REAL,
    value REAL,
    -- The quantity of `value`; NULL in events of versions before 51, which had that of the anomaly.
    quantity TEXT,
    message TEXT NOT NULL,
    -- The latest run that had shown it then.
    run_id INTEGER REFERENCES run ON DELETE SET NULL,
    -- The person; NULL for the program.
    who TEXT,
    why TEXT,
    at_text TEXT GENERATED ALWAYS AS (time_text(at)) STORED
) STRICT;

-- Messages to the receivers of alarms.

CREATE TABLE delivery_route (
    delivery_route_id INTEGER PRIMARY KEY AUTOINCREMENT,
    name TEXT NOT NULL UNIQUE,
    -- Events up to this number have a row in `delivery`, or the route does not want them.
    seen_event_id INTEGER NOT NULL,
    -- Attempts in a row that did not reach the receiver, and when the next one is made; microseconds since 1970.
    failures INTEGER NOT NULL DEFAULT 0 CHECK (failures >= 0),
    retry_at INTEGER,
    -- Not in the configuration any more.
    retired INTEGER NOT NULL DEFAULT 0 CHECK (retired IN (0, 1))
) STRICT;

CREATE TABLE delivery (
    delivery_id INTEGER PRIMARY KEY AUTOINCREMENT,
    delivery_route_id INTEGER NOT NULL REFERENCES delivery_route ON DELETE CASCADE,
    anomaly_event_id INTEGER NOT NULL REFERENCES anomaly_event ON DELETE CASCADE,
    state TEXT NOT NULL CHECK (state IN ('pending', 'sent', 'failed', 'suppressed')),
    -- Why it is not sent at once.
    held TEXT CHECK (held IN ('quiet', 'digest', 'flood')),
    -- The digest that it goes out with: the largest number of an event in it.
    digest INTEGER,
    created_at INTEGER NOT NULL,
    -- Not before this moment.
    due_at INTEGER NOT NULL,
    attempts INTEGER NOT NULL DEFAULT 0 CHECK (attempts >= 0),
    first_attempted_at INTEGER,
    attempted_at INTEGER,
    sent_at INTEGER,
    -- Of the latest attempt that failed, or why it is not sent at all.
    error TEXT,
    -- What the receiver was told in the latest attempt, where it knows an alarm by its labels.
    told_kind TEXT,
    told_severity TEXT,
    due_at_text TEXT GENERATED ALWAYS AS (time_text(due_at)) STORED,
    attempted_at_text TEXT GENERATED ALWAYS AS (time_text(attempted_at)) STORED,
    sent_at_text TEXT GENERATED ALWAYS AS (time_text(sent_at)) STORED,
    UNIQUE (delivery_route_id, anomaly_event_id)
) STRICT;

-- The database itself.

CREATE TABLE database_identity (
    only_one INTEGER PRIMARY KEY CHECK (only_one = 1),
    identity TEXT NOT NULL
) STRICT;

CREATE TABLE view_column (
    view_name TEXT NOT NULL,
    column_name TEXT NOT NULL,
    position INTEGER NOT NULL,
    type TEXT NOT NULL,
    unit TEXT,
    null_when TEXT,
    meaning TEXT NOT NULL,
    PRIMARY KEY (view_name, position)
) STRICT;
