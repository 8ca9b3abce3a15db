-- made from migrations 49bee690576566734caed14fa7c2393f385310cf6dd3095295d01a59b21dfd62
PRAGMA application_id = 1098343522;
CREATE TABLE _sqlx_migrations (
    version BIGINT PRIMARY KEY,
    description TEXT NOT NULL,
    installed_on TIMESTAMP NOT NULL DEFAULT CURRENT_TIMESTAMP,
    success BOOLEAN NOT NULL,
    checksum BLOB NOT NULL,
    execution_time BIGINT NOT NULL
);
CREATE TABLE robot (
    robot_id INTEGER PRIMARY KEY,
    name     TEXT NOT NULL UNIQUE
, history INTEGER NOT NULL DEFAULT 0, concluded INTEGER NOT NULL DEFAULT 0, expected_by TEXT, watched INTEGER NOT NULL DEFAULT 0 CHECK (watched IN (0, 1)), overdue INTEGER NOT NULL DEFAULT 0 CHECK (overdue IN (0, 1)), peers_compared INTEGER NOT NULL DEFAULT 0) STRICT;
CREATE TABLE robot_model (
    robot_model_id   INTEGER PRIMARY KEY,
    name             TEXT NOT NULL,
    -- BLAKE3 of joint kinds, modified Denavit-Hartenberg parameters and gravity.
    description_hash BLOB NOT NULL CHECK (length(description_hash) = 32),
    UNIQUE (name, description_hash)
) STRICT;
CREATE TABLE model_parameter (
    model_parameter_id INTEGER PRIMARY KEY,
    robot_model_id     INTEGER NOT NULL REFERENCES robot_model ON DELETE CASCADE,
    joint              INTEGER NOT NULL CHECK (joint >= 1),
    name               TEXT NOT NULL,
    unit               TEXT NOT NULL,
    -- Sum of standard parameters that the base parameter stands for; NULL until described.
    grouping           TEXT,
    UNIQUE (robot_model_id, joint, name)
) STRICT;
CREATE TABLE run (
    -- AUTOINCREMENT: the number of a discarded run is never given to another one.
    run_id         INTEGER PRIMARY KEY AUTOINCREMENT,
    robot_id       INTEGER NOT NULL REFERENCES robot ON DELETE CASCADE,
    model          TEXT NOT NULL,
    robot_model_id INTEGER REFERENCES robot_model,
    started_at     INTEGER NOT NULL,
    source_name    TEXT NOT NULL,
    source_path    TEXT NOT NULL,
    source_bytes   INTEGER NOT NULL CHECK (source_bytes >= 0),
    -- The same bytes under another name are the same run.
    content_hash   BLOB NOT NULL UNIQUE CHECK (length(content_hash) = 32),
    rows           INTEGER CHECK (rows >= 0),
    sample_rate_hz REAL,
    -- Mark of progress: moves in the transaction that stores a cycle, so a reader that starts again
    -- knows where to go on.
    cycles_stored  INTEGER NOT NULL DEFAULT 0 CHECK (cycles_stored >= 0),
    cycles_total   INTEGER,
    status         TEXT NOT NULL CHECK (status IN ('streaming', 'complete', 'quarantined')),
    reason         TEXT,
    -- Where in the export reading stopped, if it was at a place.
    reason_line    INTEGER,
    reason_column  TEXT,
    -- Wall time, for people who look for what arrived when. In no view: views of two databases fed
    -- alike are alike.
    ingested_at    INTEGER NOT NULL DEFAULT (CAST(unixepoch('subsec') * 1000000 AS INTEGER)), growing INTEGER NOT NULL DEFAULT 0 CHECK (growing IN (0, 1)), prefix_bytes INTEGER CHECK (prefix_bytes >= 0), prefix_hash BLOB CHECK (length(prefix_hash) = 32), replaces_run_id INTEGER REFERENCES run ON DELETE SET NULL, superseded_by_run_id INTEGER REFERENCES run ON DELETE SET NULL, device INTEGER, inode INTEGER, kind TEXT NOT NULL DEFAULT 'test' CHECK (kind IN ('test', 'production')), retry_asked_at INTEGER, made_with BLOB CHECK (length(made_with) = 32), first_rows BLOB CHECK (length(first_rows) = 32), rows_skipped INTEGER CHECK (rows_skipped >= 0), figures_hash BLOB CHECK (length(figures_hash) = 32), started_at_text TEXT, retry_asked_at_text TEXT, host_session_id INTEGER REFERENCES host_session, set_aside TEXT CHECK (set_aside IN ('person', 'implausible_date')), date_problem TEXT, recorded_start INTEGER, recorded_start_text TEXT,
    CHECK ((status = 'quarantined') = (reason IS NOT NULL)),
    CHECK (status <> 'complete' OR (rows IS NOT NULL AND cycles_total = cycles_stored))
) STRICT;
CREATE INDEX run_by_robot ON run (robot_id, status, started_at, run_id);
CREATE TABLE source_file (
    path     TEXT PRIMARY KEY,
    bytes    INTEGER NOT NULL,
    modified INTEGER NOT NULL,
    run_id   INTEGER NOT NULL REFERENCES run ON DELETE CASCADE
) STRICT, WITHOUT ROWID;
CREATE INDEX source_file_by_run ON source_file (run_id);
CREATE TABLE cycle (
    cycle_id                INTEGER PRIMARY KEY,
    run_id                  INTEGER NOT NULL REFERENCES run ON DELETE CASCADE,
    number                  INTEGER NOT NULL CHECK (number >= 1),
    started_at              INTEGER NOT NULL,
    duration_s              REAL NOT NULL,
    rows                    INTEGER NOT NULL CHECK (rows >= 0),
    sample_rate_hz          REAL,
    cutoff_hz               REAL,
    -- refused: the cycle gave no parameters, for the stated reason.
    status                  TEXT NOT NULL CHECK (status IN ('complete', 'refused')),
    reason                  TEXT,
    -- What a user should know of the data, a sentence a line.
    remarks                 TEXT,
    samples                 INTEGER,
    condition_number        REAL,
    scaled_condition_number REAL,
    residual_std_nm         REAL, estimator TEXT NOT NULL DEFAULT 'ordinary'
    CHECK (estimator IN ('ordinary', 'weighted', 'huber')), mean_speeds_rad_s TEXT
    CHECK (mean_speeds_rad_s IS NULL OR json_valid(mean_speeds_rad_s)), error_basis TEXT CHECK (error_basis IN ('blocks', 'independent_rows')), estimator_wanted TEXT CHECK (estimator_wanted IN ('ordinary', 'weighted', 'huber')), estimator_reason TEXT, doubtful INTEGER NOT NULL DEFAULT 0 CHECK (doubtful IN (0, 1)), cut_by_end INTEGER NOT NULL DEFAULT 0 CHECK (cut_by_end IN (0, 1)), started_at_text TEXT, factors_gone TEXT CHECK (factors_gone IN ('joined', 'removed')),
    UNIQUE (run_id, number),
    CHECK ((status = 'refused') = (reason IS NOT NULL))
) STRICT;
CREATE TABLE cycle_parameter (
    cycle_id           INTEGER NOT NULL REFERENCES cycle ON DELETE CASCADE,
    model_parameter_id INTEGER NOT NULL REFERENCES model_parameter,
    value              REAL NOT NULL,
    std_error          REAL, degrees_of_freedom REAL, half_width_95 REAL,
    PRIMARY KEY (cycle_id, model_parameter_id)
) STRICT, WITHOUT ROWID;
CREATE TABLE torque_rmsd (
    torque_rmsd_id       INTEGER PRIMARY KEY,
    cycle_id             INTEGER NOT NULL REFERENCES cycle ON DELETE CASCADE,
    joint                INTEGER NOT NULL CHECK (joint >= 1),
    stage                TEXT NOT NULL CHECK (stage IN ('excitation', 'friction', 'warming', 'all')),
    -- self: the cycle's own parameters; cross: those of the reference run.
    verification         TEXT NOT NULL CHECK (verification IN ('self', 'cross')),
    reference_run_id     INTEGER REFERENCES run ON DELETE CASCADE,
    rmsd_nm              REAL,
    relative_rmsd        REAL,
    moving_rmsd_nm       REAL,
    moving_relative_rmsd REAL,
    samples              INTEGER NOT NULL CHECK (samples >= 0),
    moving_samples       INTEGER NOT NULL CHECK (moving_samples >= 0), estimator TEXT CHECK (estimator IN ('ordinary', 'weighted', 'huber')),
    CHECK ((verification = 'cross') = (reference_run_id IS NOT NULL))
) STRICT;
CREATE UNIQUE INDEX torque_rmsd_key ON torque_rmsd (cycle_id, stage, joint, ifnull(reference_run_id, 0));
CREATE INDEX torque_rmsd_by_reference ON torque_rmsd (reference_run_id) WHERE reference_run_id IS NOT NULL;
CREATE TABLE friction_point (
    cycle_id       INTEGER NOT NULL REFERENCES cycle ON DELETE CASCADE,
    speed_fraction REAL NOT NULL,
    number         INTEGER NOT NULL,
    joint          INTEGER NOT NULL CHECK (joint >= 1),
    -- Since the start of the recording.
    time_s         REAL NOT NULL,
    speed_rad_s    REAL NOT NULL,
    direction      INTEGER NOT NULL CHECK (direction IN (-1, 1)),
    torque_nm      REAL NOT NULL,
    std_nm         REAL,
    samples        INTEGER NOT NULL CHECK (samples >= 0),
    -- How the load of gravity was taken away.
    gravity        TEXT NOT NULL CHECK (gravity IN ('axis_vertical', 'fitted', 'model')),
    PRIMARY KEY (cycle_id, speed_fraction, number)
) STRICT, WITHOUT ROWID;
CREATE TABLE warmup_fit (
    warmup_fit_id    INTEGER PRIMARY KEY,
    robot_id         INTEGER NOT NULL REFERENCES robot ON DELETE CASCADE,
    run_id           INTEGER REFERENCES run ON DELETE CASCADE,
    joint            INTEGER NOT NULL CHECK (joint >= 1),
    speed_fraction   REAL NOT NULL,
    model            TEXT NOT NULL CHECK (model IN ('double', 'single', 'constant')),
    a_nm             REAL NOT NULL,
    a_std_error_nm   REAL,
    b_nm             REAL,
    b_std_error_nm   REAL,
    t1_min           REAL,
    t1_std_error_min REAL,
    c_nm             REAL,
    c_std_error_nm   REAL,
    t2_min           REAL,
    t2_std_error_min REAL,
    rmsd_nm          REAL,
    samples          INTEGER NOT NULL CHECK (samples >= 0), first_min REAL, last_min REAL, a_extrapolated INTEGER CHECK (a_extrapolated IN (0, 1)), c_first_nm REAL, c_first_std_error_nm REAL, t2_max_min REAL,
    CHECK ((model = 'constant') = (b_nm IS NULL)),
    CHECK ((model = 'double') = (c_nm IS NOT NULL)),
    CHECK ((b_nm IS NULL) = (t1_min IS NULL) AND (c_nm IS NULL) = (t2_min IS NULL)),
    CHECK (t2_min IS NULL OR t1_min > t2_min)
) STRICT;
CREATE UNIQUE INDEX warmup_fit_key ON warmup_fit (robot_id, ifnull(run_id, 0), joint, speed_fraction);
CREATE INDEX warmup_fit_by_run ON warmup_fit (run_id) WHERE run_id IS NOT NULL;
CREATE TABLE parameter_statistic (
    run_id             INTEGER NOT NULL REFERENCES run ON DELETE CASCADE,
    model_parameter_id INTEGER NOT NULL REFERENCES model_parameter,
    "window"           TEXT NOT NULL CHECK ("window" IN ('all', 'after_5')),
    mean               REAL NOT NULL,
    min                REAL NOT NULL,
    max                REAL NOT NULL,
    -- (max - min) / |max|
    d_mm               REAL,
    -- |last - first| / |first|
    d_se               REAL,
    sdv                REAL,
    cycles             INTEGER NOT NULL CHECK (cycles >= 1),
    PRIMARY KEY (run_id, model_parameter_id, "window")
) STRICT, WITHOUT ROWID;
CREATE TABLE run_joint_summary (
    run_id                     INTEGER NOT NULL REFERENCES run ON DELETE CASCADE,
    joint                      INTEGER NOT NULL CHECK (joint >= 1),
    warm_friction_nm           REAL,
    warm_friction_std_error_nm REAL,
    -- Mean time of the points: runs compare at equal warmth only.
    warm_minute                REAL,
    warm_speed_fraction        REAL,
    -- Median over cycles of the moving relative RMSD of the excitation stage.
    relative_rmsd              REAL,
    -- How much that RMSD swings from cycle to cycle, and over how many cycles.
    rmsd_swing                 REAL,
    rmsd_swing_cycles          INTEGER, estimator TEXT CHECK (estimator IN ('ordinary', 'weighted', 'huber')), excitation_friction_nm REAL, excitation_friction_std_error_nm REAL, excitation_minute REAL, excitation_speed_fraction REAL, relative_noise REAL, torque_rms_nm REAL,
    PRIMARY KEY (run_id, joint)
) STRICT, WITHOUT ROWID;
CREATE VIEW friction_points AS
SELECT robot.name AS robot,
       cycle.run_id,
       cycle.number AS cycle,
       friction_point.time_s / 60.0 AS minute,
       friction_point.joint,
       friction_point.speed_fraction,
       friction_point.speed_rad_s,
       friction_point.direction,
       friction_point.torque_nm,
       friction_point.std_nm,
       friction_point.samples,
       friction_point.gravity
FROM friction_point
JOIN cycle USING (cycle_id)
JOIN run USING (run_id)
JOIN robot USING (robot_id);
CREATE VIEW parameter_statistics AS
SELECT robot.name AS robot,
       parameter_statistic.run_id,
       model_parameter.joint,
       model_parameter.name AS parameter,
       parameter_statistic."window",
       parameter_statistic.mean,
       parameter_statistic.min,
       parameter_statistic.max,
       parameter_statistic.d_mm,
       parameter_statistic.d_se,
       parameter_statistic.sdv,
       parameter_statistic.cycles
FROM parameter_statistic
JOIN model_parameter USING (model_parameter_id)
JOIN run USING (run_id)
JOIN robot USING (robot_id);
CREATE TABLE factor_layout (
    factor_layout_id INTEGER PRIMARY KEY,
    robot_model_id   INTEGER NOT NULL REFERENCES robot_model ON DELETE CASCADE,
    -- JSON: for each joint, from the first, the model_parameter_id of each column.
    columns          TEXT NOT NULL CHECK (json_valid(columns)),
    UNIQUE (robot_model_id, columns)
) STRICT;
CREATE TABLE cycle_factor_layout (
    cycle_id         INTEGER PRIMARY KEY REFERENCES cycle ON DELETE CASCADE,
    factor_layout_id INTEGER NOT NULL REFERENCES factor_layout
) STRICT;
CREATE INDEX cycle_factor_layout_by_layout ON cycle_factor_layout (factor_layout_id);
CREATE TABLE torque_factor (
    torque_factor_id INTEGER PRIMARY KEY,
    cycle_id         INTEGER NOT NULL REFERENCES cycle ON DELETE CASCADE,
    joint            INTEGER NOT NULL CHECK (joint >= 1),
    stage            TEXT NOT NULL CHECK (stage IN ('excitation', 'friction', 'warming', 'between')),
    -- Whether the joint moves at its low-speed threshold or faster.
    motion           TEXT NOT NULL CHECK (motion IN ('moving', 'slow')),
    rows             INTEGER NOT NULL CHECK (rows >= 1),
    -- Upper triangle, column after column, 8-byte little-endian floats; the last column is the torque.
    -- Last, so that the other columns are read without its overflow pages.
    factor           BLOB NOT NULL,
    UNIQUE (cycle_id, stage, motion, joint)
) STRICT;
CREATE TABLE warming_rmsd (
    cycle_id             INTEGER NOT NULL REFERENCES cycle ON DELETE CASCADE,
    joint                INTEGER NOT NULL CHECK (joint >= 1),
    part                 TEXT NOT NULL CHECK (part IN ('start', 'end')),
    rmsd_nm              REAL,
    relative_rmsd        REAL,
    moving_rmsd_nm       REAL,
    moving_relative_rmsd REAL,
    samples              INTEGER NOT NULL CHECK (samples >= 0),
    moving_samples       INTEGER NOT NULL CHECK (moving_samples >= 0), estimator TEXT CHECK (estimator IN ('ordinary', 'weighted', 'huber')),
    PRIMARY KEY (cycle_id, joint, part)
) STRICT, WITHOUT ROWID;
CREATE TABLE parameter_set (
    parameter_set_id        INTEGER PRIMARY KEY,
    name                    TEXT NOT NULL UNIQUE,
    robot_model_id          INTEGER NOT NULL REFERENCES robot_model,
    samples                 INTEGER NOT NULL CHECK (samples >= 1),
    condition_number        REAL,
    scaled_condition_number REAL,
    residual_std_nm         REAL,
    -- As run.ingested_at.
    saved_at                INTEGER NOT NULL DEFAULT (CAST(unixepoch('subsec') * 1000000 AS INTEGER))
, estimator TEXT NOT NULL DEFAULT 'ordinary'
    CHECK (estimator IN ('ordinary', 'weighted', 'per-joint', 'huber', 'prior')), error_basis TEXT NOT NULL DEFAULT 'independent_rows'
    CHECK (error_basis IN ('cycles', 'independent_rows'))) STRICT;
CREATE INDEX parameter_set_by_model ON parameter_set (robot_model_id);
CREATE TABLE parameter_set_value (
    parameter_set_id   INTEGER NOT NULL REFERENCES parameter_set ON DELETE CASCADE,
    model_parameter_id INTEGER NOT NULL REFERENCES model_parameter,
    value              REAL NOT NULL,
    std_error          REAL, degrees_of_freedom REAL,
    PRIMARY KEY (parameter_set_id, model_parameter_id)
) STRICT, WITHOUT ROWID;
CREATE TABLE parameter_set_source (
    parameter_set_id INTEGER NOT NULL REFERENCES parameter_set ON DELETE CASCADE,
    run_id           INTEGER NOT NULL,
    cycle            INTEGER NOT NULL,
    robot            TEXT NOT NULL,
    PRIMARY KEY (parameter_set_id, run_id, cycle)
) STRICT, WITHOUT ROWID;
CREATE VIEW parameter_set_sources AS
SELECT parameter_set.name AS parameter_set,
       parameter_set_source.robot,
       parameter_set_source.run_id,
       parameter_set_source.cycle
FROM parameter_set_source
JOIN parameter_set USING (parameter_set_id);
CREATE TABLE joint_residual (
    cycle_id          INTEGER NOT NULL REFERENCES cycle ON DELETE CASCADE,
    joint             INTEGER NOT NULL CHECK (joint >= 1),
    residual_std_nm   REAL,
    -- Independent rows over the joint's rows, for errors from factors alone. Above 1 where the noise is
    -- less at the frequencies of the motion than above them.
    independent_share REAL CHECK (independent_share > 0),
    PRIMARY KEY (cycle_id, joint)
) STRICT, WITHOUT ROWID;
CREATE VIEW joint_residuals AS
SELECT robot.name AS robot,
       cycle.run_id,
       cycle.number AS cycle,
       joint_residual.joint,
       joint_residual.residual_std_nm,
       joint_residual.independent_share
FROM joint_residual
JOIN cycle USING (cycle_id)
JOIN run USING (run_id)
JOIN robot USING (robot_id);
CREATE VIEW parameter_sets AS
SELECT parameter_set.name AS parameter_set,
       robot_model.name AS model,
       model_parameter.joint,
       model_parameter.name AS parameter,
       parameter_set_value.value,
       parameter_set_value.std_error,
       model_parameter.unit,
       model_parameter.grouping,
       (SELECT count(*) FROM parameter_set_source
        WHERE parameter_set_source.parameter_set_id = parameter_set.parameter_set_id) AS cycles,
       parameter_set.samples,
       parameter_set.condition_number,
       parameter_set.scaled_condition_number,
       parameter_set.residual_std_nm,
       parameter_set.estimator,
       parameter_set.error_basis
FROM parameter_set
JOIN robot_model USING (robot_model_id)
JOIN parameter_set_value USING (parameter_set_id)
JOIN model_parameter USING (model_parameter_id);
CREATE TABLE reestimate (
    reestimate_id  INTEGER PRIMARY KEY,
    name           TEXT NOT NULL UNIQUE,
    robot_model_id INTEGER NOT NULL REFERENCES robot_model,
    estimator      TEXT NOT NULL CHECK (estimator IN ('ordinary', 'weighted', 'per-joint', 'huber', 'prior')),
    -- As run.ingested_at.
    saved_at       INTEGER NOT NULL DEFAULT (CAST(unixepoch('subsec') * 1000000 AS INTEGER))
) STRICT;
CREATE INDEX reestimate_by_model ON reestimate (robot_model_id);
CREATE TABLE reestimate_cycle (
    reestimate_cycle_id INTEGER PRIMARY KEY,
    reestimate_id       INTEGER NOT NULL REFERENCES reestimate ON DELETE CASCADE,
    robot               TEXT NOT NULL,
    run_id              INTEGER NOT NULL,
    cycle               INTEGER NOT NULL,
    -- Why it, or some of its joints, gave no parameters.
    reason              TEXT,
    UNIQUE (reestimate_id, run_id, cycle)
) STRICT;
CREATE TABLE reestimate_view (
    reestimate_cycle_id     INTEGER NOT NULL REFERENCES reestimate_cycle ON DELETE CASCADE,
    seen_by_joint           INTEGER NOT NULL CHECK (seen_by_joint >= 0),
    samples                 INTEGER NOT NULL CHECK (samples >= 1),
    condition_number        REAL,
    scaled_condition_number REAL,
    residual_std_nm         REAL,
    PRIMARY KEY (reestimate_cycle_id, seen_by_joint)
) STRICT, WITHOUT ROWID;
CREATE TABLE reestimate_value (
    reestimate_cycle_id INTEGER NOT NULL REFERENCES reestimate_cycle ON DELETE CASCADE,
    seen_by_joint       INTEGER NOT NULL CHECK (seen_by_joint >= 0),
    model_parameter_id  INTEGER NOT NULL REFERENCES model_parameter,
    value               REAL NOT NULL,
    std_error           REAL,
    -- Half the width of the 95 % interval: Student's quantile is no function of SQL.
    half_width_95       REAL,
    data_share          REAL,
    PRIMARY KEY (reestimate_cycle_id, seen_by_joint, model_parameter_id)
) STRICT, WITHOUT ROWID;
CREATE INDEX reestimate_value_by_parameter ON reestimate_value (model_parameter_id);
CREATE TABLE reestimate_statistic (
    reestimate_id      INTEGER NOT NULL REFERENCES reestimate ON DELETE CASCADE,
    robot              TEXT NOT NULL,
    run_id             INTEGER NOT NULL,
    seen_by_joint      INTEGER NOT NULL CHECK (seen_by_joint >= 0),
    model_parameter_id INTEGER NOT NULL REFERENCES model_parameter,
    "window"           TEXT NOT NULL CHECK ("window" IN ('all', 'after_5')),
    mean               REAL NOT NULL,
    min                REAL NOT NULL,
    max                REAL NOT NULL,
    d_mm               REAL,
    d_se               REAL,
    sdv                REAL,
    cycles             INTEGER NOT NULL CHECK (cycles >= 1),
    PRIMARY KEY (reestimate_id, run_id, seen_by_joint, model_parameter_id, "window")
) STRICT, WITHOUT ROWID;
CREATE INDEX reestimate_statistic_by_parameter ON reestimate_statistic (model_parameter_id);
CREATE VIEW reestimated_cycles AS
SELECT reestimate.name AS estimate,
       reestimate.estimator,
       reestimate_cycle.robot,
       reestimate_cycle.run_id,
       reestimate_cycle.cycle,
       nullif(reestimate_view.seen_by_joint, 0) AS seen_by_joint,
       reestimate_view.samples,
       reestimate_view.condition_number,
       reestimate_view.scaled_condition_number,
       reestimate_view.residual_std_nm,
       reestimate_cycle.reason
FROM reestimate
JOIN reestimate_cycle USING (reestimate_id)
LEFT JOIN reestimate_view USING (reestimate_cycle_id);
CREATE VIEW reestimated_parameters AS
SELECT reestimate.name AS estimate,
       reestimate_cycle.robot,
       reestimate_cycle.run_id,
       reestimate_cycle.cycle,
       nullif(reestimate_value.seen_by_joint, 0) AS seen_by_joint,
       model_parameter.joint,
       model_parameter.name AS parameter,
       reestimate_value.value,
       reestimate_value.std_error,
       reestimate_value.value - reestimate_value.half_width_95 AS interval_low,
       reestimate_value.value + reestimate_value.half_width_95 AS interval_high,
       reestimate_value.data_share,
       model_parameter.unit,
       model_parameter.grouping
FROM reestimate
JOIN reestimate_cycle USING (reestimate_id)
JOIN reestimate_value USING (reestimate_cycle_id)
JOIN model_parameter USING (model_parameter_id);
CREATE VIEW reestimated_statistics AS
SELECT reestimate.name AS estimate,
       reestimate_statistic.robot,
       reestimate_statistic.run_id,
       nullif(reestimate_statistic.seen_by_joint, 0) AS seen_by_joint,
       model_parameter.joint,
       model_parameter.name AS parameter,
       reestimate_statistic."window",
       reestimate_statistic.mean,
       reestimate_statistic.min,
       reestimate_statistic.max,
       reestimate_statistic.d_mm,
       reestimate_statistic.d_se,
       reestimate_statistic.sdv,
       reestimate_statistic.cycles
FROM reestimate
JOIN reestimate_statistic USING (reestimate_id)
JOIN model_parameter USING (model_parameter_id);
CREATE TABLE friction_speed_fit (
    friction_speed_fit_id  INTEGER PRIMARY KEY,
    cycle_id               INTEGER NOT NULL REFERENCES cycle ON DELETE CASCADE,
    joint                  INTEGER NOT NULL CHECK (joint >= 1),
    direction              INTEGER NOT NULL CHECK (direction IN (-1, 1)),
    model                  TEXT NOT NULL CHECK (model IN ('coulomb', 'coulomb_viscous', 'power_law', 'stribeck', 'polynomial')),
    slowest_rad_s          REAL NOT NULL,
    fastest_rad_s          REAL NOT NULL,
    rmsd_nm                REAL,
    reduced_chi_square     REAL,
    points                 INTEGER NOT NULL CHECK (points >= 0),
    asymmetry_nm           REAL,
    asymmetry_std_error_nm REAL,
    UNIQUE (cycle_id, joint, direction)
) STRICT;
CREATE TABLE friction_speed_coefficient (
    friction_speed_fit_id INTEGER NOT NULL REFERENCES friction_speed_fit ON DELETE CASCADE,
    name                  TEXT NOT NULL,
    value                 REAL NOT NULL,
    std_error             REAL,
    -- Held at zero, since the data alone would have friction drive the joint.
    at_bound              INTEGER NOT NULL CHECK (at_bound IN (0, 1)),
    PRIMARY KEY (friction_speed_fit_id, name)
) STRICT, WITHOUT ROWID;
CREATE TABLE friction_law (
    robot_id                INTEGER NOT NULL REFERENCES robot ON DELETE CASCADE,
    joint                   INTEGER NOT NULL CHECK (joint >= 1),
    slow_min                REAL NOT NULL,
    slow_std_error_min      REAL,
    fast_min                REAL NOT NULL,
    fast_std_error_min      REAL,
    slow_share              REAL NOT NULL,
    slow_share_std_error    REAL,
    cooling_ratio           REAL NOT NULL,
    cooling_ratio_std_error REAL,
    relative_rmsd           REAL,
    explained               REAL,
    runs                    INTEGER NOT NULL CHECK (runs >= 0),
    points                  INTEGER NOT NULL CHECK (points >= 0),
    remarks                 TEXT,
    -- JSON, row after row: warm friction by level, cold part by level, logarithms of the slow and the fast
    -- time constant in seconds, share of the slow part, logarithm of the cooling ratio.
    covariance              TEXT NOT NULL CHECK (json_valid(covariance)), thermal_source TEXT NOT NULL DEFAULT 'motion'
    CHECK (thermal_source IN ('motion', 'motor_temperature', 'ambient_and_motion')), warm_degc REAL, cold_degc REAL, curvature REAL, curvature_std_error REAL, ambient_degc REAL, coldness_1_k REAL, coldness_std_error_1_k REAL, basis BLOB CHECK (length(basis) = 32),
    PRIMARY KEY (robot_id, joint)
) STRICT, WITHOUT ROWID;
CREATE TABLE friction_level (
    robot_id          INTEGER NOT NULL,
    joint             INTEGER NOT NULL,
    speed_fraction    REAL NOT NULL,
    warm_nm           REAL NOT NULL,
    warm_std_error_nm REAL,
    cold_nm           REAL NOT NULL CHECK (cold_nm >= 0),
    cold_std_error_nm REAL,
    PRIMARY KEY (robot_id, joint, speed_fraction),
    FOREIGN KEY (robot_id, joint) REFERENCES friction_law ON DELETE CASCADE
) STRICT, WITHOUT ROWID;
CREATE TABLE run_friction_index (
    run_id                   INTEGER NOT NULL REFERENCES run ON DELETE CASCADE,
    joint                    INTEGER NOT NULL CHECK (joint >= 1),
    friction_index           REAL NOT NULL,
    friction_index_std_error REAL,
    ambient_coldness           REAL NOT NULL,
    ambient_coldness_std_error REAL,
    coldness_at_start          REAL NOT NULL,
    points                     INTEGER NOT NULL CHECK (points >= 0), raw_index REAL, short_run INTEGER NOT NULL DEFAULT 0 CHECK (short_run IN (0, 1)),
    PRIMARY KEY (run_id, joint)
) STRICT, WITHOUT ROWID;
CREATE VIEW friction_speed_fits AS
SELECT robot.name AS robot,
       cycle.run_id,
       cycle.number AS cycle,
       fit.joint,
       fit.direction,
       fit.model,
       coefficient.name AS coefficient,
       coefficient.value,
       coefficient.std_error,
       coefficient.at_bound,
       fit.slowest_rad_s,
       fit.fastest_rad_s,
       fit.rmsd_nm,
       fit.reduced_chi_square,
       fit.points,
       fit.asymmetry_nm,
       fit.asymmetry_std_error_nm
FROM friction_speed_fit AS fit
JOIN friction_speed_coefficient AS coefficient USING (friction_speed_fit_id)
JOIN cycle USING (cycle_id)
JOIN run USING (run_id)
JOIN robot USING (robot_id);
CREATE INDEX run_by_replaced ON run (replaces_run_id) WHERE replaces_run_id IS NOT NULL;
CREATE INDEX run_by_successor ON run (superseded_by_run_id) WHERE superseded_by_run_id IS NOT NULL;
CREATE INDEX run_by_file ON run (inode, device) WHERE inode IS NOT NULL;
CREATE TABLE production_check (
    cycle_id             INTEGER NOT NULL REFERENCES cycle ON DELETE CASCADE,
    joint                INTEGER NOT NULL CHECK (joint >= 1),
    reference_run_id     INTEGER NOT NULL REFERENCES run ON DELETE CASCADE,
    rmsd_nm              REAL,
    relative_rmsd        REAL,
    samples              INTEGER NOT NULL CHECK (samples >= 0),
    moving_rmsd_nm       REAL,
    moving_relative_rmsd REAL,
    moving_samples       INTEGER NOT NULL CHECK (moving_samples >= 0), friction_excess REAL, friction_share REAL, settled INTEGER NOT NULL DEFAULT 0 CHECK (settled IN (0, 1)), estimator TEXT NOT NULL DEFAULT 'ordinary'
    CHECK (estimator IN ('ordinary', 'weighted', 'huber')),
    -- Mean and largest size of measured less estimated torque over the moving rows; NULL where the check was
    -- made later, from factors,
    PRIMARY KEY (cycle_id, joint)
) STRICT, WITHOUT ROWID;
CREATE INDEX production_check_by_reference ON production_check (reference_run_id);
CREATE TABLE fault (
    fault_id      INTEGER PRIMARY KEY,
    run_id        INTEGER NOT NULL REFERENCES run ON DELETE CASCADE,
    -- Without place and remedy; where there is a value, it goes on after "value is ".
    problem       TEXT NOT NULL,
    -- In the decompressed file: lines from 1, bytes from 0, of the cell or else of the line.
    line          INTEGER CHECK (line >= 1),
    column_name   TEXT,
    byte          INTEGER CHECK (byte >= 0),
    value         TEXT,
    remedy        TEXT NOT NULL,
    -- Whole cycles before the fault, which were stored.
    cycles_stored INTEGER NOT NULL CHECK (cycles_stored >= 0),
    -- Attempts that found just this, one after the other, and when the first and the last did.
    tries         INTEGER NOT NULL DEFAULT 1 CHECK (tries >= 1),
    first_at      INTEGER NOT NULL DEFAULT (CAST(unixepoch('subsec') * 1000000 AS INTEGER)),
    last_at       INTEGER NOT NULL DEFAULT (CAST(unixepoch('subsec') * 1000000 AS INTEGER))
, first_at_text TEXT, last_at_text TEXT) STRICT;
CREATE INDEX fault_by_run ON fault (run_id, fault_id);
CREATE INDEX run_by_retry ON run (retry_asked_at) WHERE retry_asked_at IS NOT NULL;
CREATE INDEX run_by_name ON run (source_name);
CREATE TRIGGER run_changes_history AFTER UPDATE OF status ON run
WHEN OLD.status = 'complete' OR NEW.status = 'complete'
BEGIN
    UPDATE robot SET history = history + 1 WHERE robot_id IN (OLD.robot_id, NEW.robot_id);
END;
CREATE TRIGGER run_leaves_history AFTER DELETE ON run
WHEN OLD.status = 'complete'
BEGIN
    UPDATE robot SET history = history + 1 WHERE robot_id = OLD.robot_id;
END;
CREATE TABLE cycle_temperature (
    cycle_id         INTEGER NOT NULL REFERENCES cycle ON DELETE CASCADE,
    joint            INTEGER NOT NULL CHECK (joint >= 0),
    temperature_degc REAL NOT NULL,
    PRIMARY KEY (cycle_id, joint)
) STRICT, WITHOUT ROWID;
CREATE TABLE resume_point (
    run_id INTEGER PRIMARY KEY REFERENCES run ON DELETE CASCADE,
    cycles INTEGER NOT NULL CHECK (cycles >= 1),
    byte   INTEGER NOT NULL CHECK (byte >= 0),
    state  BLOB NOT NULL
) STRICT;
CREATE TABLE production_summary (
    run_id           INTEGER NOT NULL REFERENCES run ON DELETE CASCADE,
    reference_run_id INTEGER NOT NULL REFERENCES run ON DELETE CASCADE,
    joint            INTEGER NOT NULL CHECK (joint >= 1),
    windows          INTEGER NOT NULL CHECK (windows >= 1),
    relative_rmsd    REAL NOT NULL,
    friction_excess  REAL NOT NULL,
    friction_share   REAL NOT NULL,
    PRIMARY KEY (run_id, reference_run_id, joint)
) STRICT, WITHOUT ROWID;
CREATE INDEX production_summary_by_reference ON production_summary (reference_run_id);
CREATE TRIGGER quarantined_production_changes_history AFTER UPDATE OF status ON run
WHEN NEW.kind = 'production' AND NEW.status = 'quarantined' AND OLD.status = 'streaming'
BEGIN
    UPDATE robot SET history = history + 1 WHERE robot_id = NEW.robot_id;
END;
CREATE INDEX cycle_with_kept_estimate ON cycle (estimator_wanted) WHERE estimator_wanted IS NOT NULL;
CREATE TABLE interval_fill (
    after_cycle_id INTEGER NOT NULL
) STRICT;
CREATE VIEW cycle_rmsd AS
SELECT robot.name AS robot,
       cycle.run_id,
       cycle.number AS cycle,
       torque_rmsd.joint,
       torque_rmsd.stage,
       torque_rmsd.verification,
       torque_rmsd.reference_run_id,
       torque_rmsd.rmsd_nm,
       torque_rmsd.relative_rmsd,
       torque_rmsd.moving_rmsd_nm,
       torque_rmsd.moving_relative_rmsd,
       torque_rmsd.samples,
       torque_rmsd.moving_samples,
       ifnull(torque_rmsd.estimator, cycle.estimator) AS estimator
FROM torque_rmsd
JOIN cycle USING (cycle_id)
JOIN run USING (run_id)
JOIN robot USING (robot_id);
CREATE VIEW warming_contrast AS
SELECT robot.name AS robot,
       cycle.run_id,
       cycle.number AS cycle,
       first_third.joint,
       first_third.rmsd_nm AS start_rmsd_nm,
       last_third.rmsd_nm AS end_rmsd_nm,
       first_third.relative_rmsd AS start_relative_rmsd,
       last_third.relative_rmsd AS end_relative_rmsd,
       first_third.moving_rmsd_nm AS start_moving_rmsd_nm,
       last_third.moving_rmsd_nm AS end_moving_rmsd_nm,
       first_third.moving_relative_rmsd AS start_moving_relative_rmsd,
       last_third.moving_relative_rmsd AS end_moving_relative_rmsd,
       first_third.samples AS start_samples,
       last_third.samples AS end_samples,
       first_third.moving_samples AS start_moving_samples,
       last_third.moving_samples AS end_moving_samples,
       ifnull(first_third.estimator, cycle.estimator) AS estimator
FROM warming_rmsd AS first_third
JOIN warming_rmsd AS last_third
     ON last_third.cycle_id = first_third.cycle_id AND last_third.joint = first_third.joint AND last_third.part = 'end'
JOIN cycle ON cycle.cycle_id = first_third.cycle_id
JOIN run USING (run_id)
JOIN robot USING (robot_id)
WHERE first_third.part = 'start';
CREATE VIEW warmup_fits AS
SELECT robot.name AS robot,
       warmup_fit.run_id,
       warmup_fit.joint,
       warmup_fit.speed_fraction,
       warmup_fit.model,
       warmup_fit.a_nm,
       warmup_fit.b_nm,
       warmup_fit.t1_min,
       warmup_fit.c_nm,
       warmup_fit.t2_min,
       warmup_fit.a_std_error_nm,
       warmup_fit.b_std_error_nm,
       warmup_fit.t1_std_error_min,
       warmup_fit.c_std_error_nm,
       warmup_fit.t2_std_error_min,
       warmup_fit.rmsd_nm,
       warmup_fit.samples,
       warmup_fit.first_min,
       warmup_fit.last_min,
       warmup_fit.a_extrapolated,
       warmup_fit.c_first_nm,
       warmup_fit.c_first_std_error_nm,
       warmup_fit.t2_max_min
FROM warmup_fit
JOIN robot USING (robot_id);
CREATE TABLE cycle_refusal (
    cycle_id INTEGER NOT NULL REFERENCES cycle ON DELETE CASCADE,
    number   INTEGER NOT NULL CHECK (number >= 1),
    -- Name of the check, such as stuck_channel; earlier for cycles stored before this table was.
    finding  TEXT NOT NULL,
    channel  TEXT NOT NULL CHECK (channel IN (
                 'position', 'velocity', 'torque', 'time', 'rows', 'motion', 'model')),
    -- NULL: the whole arm's.
    joint    INTEGER CHECK (joint >= 1),
    sentence TEXT NOT NULL,
    PRIMARY KEY (cycle_id, number)
) STRICT, WITHOUT ROWID;
CREATE TABLE "joint_health" (
    robot_id           INTEGER NOT NULL REFERENCES robot ON DELETE CASCADE,
    joint              INTEGER NOT NULL CHECK (joint >= 1),
    friction_index     REAL,
    friction_quantity  TEXT,
    -- compared: the latest test compares with the baseline. learning: no baseline yet. unsettled: one test alone
    -- does not settle it. no_result: the latest test says nothing of the arm.
    knowledge          TEXT NOT NULL CHECK (knowledge IN ('compared', 'learning', 'unsettled', 'no_result')),
    reason             TEXT,
    last_result_run_id INTEGER REFERENCES run ON DELETE SET NULL, trend TEXT CHECK (trend IN ('none', 'rising', 'falling')), warning_by TEXT, warning_by_lower TEXT, warning_by_upper TEXT, critical_by TEXT, critical_by_lower TEXT, critical_by_upper TEXT,
    PRIMARY KEY (robot_id, joint)
) STRICT, WITHOUT ROWID;
CREATE INDEX joint_health_by_last_result ON joint_health (last_result_run_id);
CREATE TABLE conclusion_fault (
    robot_id INTEGER PRIMARY KEY REFERENCES robot ON DELETE CASCADE,
    reason   TEXT NOT NULL,
    -- Attempts that failed, one after the other, and when the first and the last did.
    tries    INTEGER NOT NULL DEFAULT 1 CHECK (tries >= 1),
    first_at INTEGER NOT NULL DEFAULT (CAST(unixepoch('subsec') * 1000000 AS INTEGER)),
    last_at  INTEGER NOT NULL DEFAULT (CAST(unixepoch('subsec') * 1000000 AS INTEGER))
, first_at_text TEXT, last_at_text TEXT) STRICT;
CREATE TABLE dismissal (
    dismissal_id INTEGER PRIMARY KEY,
    fault_id     INTEGER NOT NULL REFERENCES fault ON DELETE CASCADE,
    dismissed_at INTEGER NOT NULL DEFAULT (CAST(unixepoch('subsec') * 1000000 AS INTEGER)),
    dismissed_by TEXT NOT NULL,
    reason       TEXT NOT NULL,
    withdrawn_at INTEGER
, dismissed_at_text TEXT) STRICT;
CREATE INDEX dismissal_by_fault ON dismissal (fault_id);
CREATE UNIQUE INDEX dismissal_in_force ON dismissal (fault_id) WHERE withdrawn_at IS NULL;
CREATE TABLE "anomaly" (
    anomaly_id    INTEGER PRIMARY KEY AUTOINCREMENT,
    robot_id      INTEGER NOT NULL REFERENCES robot ON DELETE CASCADE,
    joint         INTEGER CHECK (joint >= 1),
    kind          TEXT NOT NULL CHECK (kind IN (
                      'drift', 'oscillation', 'step', 'thermal', 'payload', 'sensor', 'accuracy', 'fleet')),
    quantity      TEXT NOT NULL,
    severity      TEXT NOT NULL CHECK (severity IN ('info', 'warning', 'critical')),
    score         REAL,
    threshold     REAL,
    value         REAL,
    baseline      REAL,
    peak_value    REAL,
    peak_score    REAL,
    -- An episode outlives its runs: what people said of it is kept until the history is judged again.
    first_run_id  INTEGER REFERENCES run ON DELETE SET NULL,
    first_cycle   INTEGER CHECK (first_cycle >= 1),
    last_run_id   INTEGER REFERENCES run ON DELETE SET NULL,
    first_seen_at INTEGER NOT NULL,
    last_seen_at  INTEGER NOT NULL,
    -- Where the change most likely began; as first_* where nothing better is known.
    onset_run_id  INTEGER REFERENCES run ON DELETE SET NULL,
    onset_cycle   INTEGER CHECK (onset_cycle >= 1),
    onset_at      INTEGER,
    -- Odds of the named cause against all others together; NULL where causes were not compared.
    odds          REAL CHECK (odds >= 0),
    -- Rejected causes as a JSON array of {"cause", "odds"}, the likeliest first.
    alternatives  TEXT NOT NULL DEFAULT '[]',
    state         TEXT NOT NULL CHECK (state IN (
                      'open', 'acknowledged', 'shelved', 'maintenance', 'resolved', 'false_alarm')),
    -- Until when it is shelved.
    shelved_until INTEGER CHECK (state <> 'shelved' OR shelved_until IS NOT NULL),
    message       TEXT NOT NULL,
    -- Whether later runs no longer show it, whatever people said of it.
    ended         INTEGER NOT NULL DEFAULT 0 CHECK (ended IN (0, 1)),
    -- Start of the latest run that showed it when a person resolved it: a later one opens it again.
    resolved_seen_at INTEGER CHECK (resolved_seen_at IS NULL OR state = 'resolved'),
    -- Whether the history has it no longer; `state` then is what people had said, in case it comes back.
    withdrawn     INTEGER NOT NULL DEFAULT 0 CHECK (withdrawn IN (0, 1))
, open_run_id INTEGER REFERENCES run ON DELETE SET NULL, first_seen_at_text TEXT, last_seen_at_text TEXT, onset_at_text TEXT, shelved_until_text TEXT, settled_history_id INTEGER REFERENCES settled_history ON DELETE SET NULL) STRICT;
CREATE INDEX anomaly_by_robot ON anomaly (robot_id, kind, joint);
CREATE INDEX anomaly_by_first_run ON anomaly (first_run_id);
CREATE INDEX anomaly_by_last_run ON anomaly (last_run_id);
CREATE INDEX anomaly_by_onset_run ON anomaly (onset_run_id);
CREATE TABLE anomaly_event (
    -- AUTOINCREMENT: delivery asks for "newer than this number".
    anomaly_event_id INTEGER PRIMARY KEY AUTOINCREMENT,
    anomaly_id       INTEGER NOT NULL REFERENCES anomaly ON DELETE CASCADE,
    -- Wall time, microseconds since 1970.
    at               INTEGER NOT NULL DEFAULT (CAST(unixepoch('subsec') * 1000000 AS INTEGER)),
    what             TEXT NOT NULL CHECK (what IN (
                         'opened', 'worse', 'corrected', 'ended', 'reopened', 'withdrawn', 'overdue',
                         'acknowledged', 'shelved', 'unshelved', 'maintenance', 'resolved', 'false_alarm')),
    -- The anomaly as it was then.
    severity         TEXT NOT NULL CHECK (severity IN ('info', 'warning', 'critical')),
    score            REAL,
    value            REAL,
    message          TEXT NOT NULL,
    -- The latest run that had shown it then.
    run_id           INTEGER REFERENCES run ON DELETE SET NULL,
    -- The person; NULL where the program did it.
    who              TEXT,
    why              TEXT
, at_text TEXT) STRICT;
CREATE INDEX anomaly_event_by_anomaly ON anomaly_event (anomaly_id);
CREATE INDEX anomaly_event_by_run ON anomaly_event (run_id);
CREATE TABLE maintenance (
    maintenance_id INTEGER PRIMARY KEY AUTOINCREMENT,
    robot_id       INTEGER NOT NULL REFERENCES robot ON DELETE CASCADE,
    -- NULL: the whole arm.
    joint          INTEGER CHECK (joint >= 1),
    at             INTEGER NOT NULL,
    what           TEXT NOT NULL,
    who            TEXT,
    recorded_at    INTEGER NOT NULL DEFAULT (CAST(unixepoch('subsec') * 1000000 AS INTEGER))
, at_text TEXT, recorded_at_text TEXT) STRICT;
CREATE INDEX maintenance_by_robot ON maintenance (robot_id, at);
CREATE TABLE database_identity (
    only_one INTEGER PRIMARY KEY CHECK (only_one = 1),
    identity TEXT NOT NULL
) STRICT;
CREATE TABLE delivery_route (
    delivery_route_id INTEGER PRIMARY KEY AUTOINCREMENT,
    name              TEXT NOT NULL UNIQUE,
    -- Events up to this number have been looked at: they have a row in `delivery`, or the route does not want them.
    seen_event_id     INTEGER NOT NULL,
    -- Attempts in a row that did not reach the receiver, and when the next one is made; microseconds since 1970.
    failures          INTEGER NOT NULL DEFAULT 0 CHECK (failures >= 0),
    retry_at          INTEGER,
    -- Not in the configuration any more.
    retired           INTEGER NOT NULL DEFAULT 0 CHECK (retired IN (0, 1))
) STRICT;
CREATE TABLE delivery (
    delivery_id       INTEGER PRIMARY KEY AUTOINCREMENT,
    delivery_route_id INTEGER NOT NULL REFERENCES delivery_route ON DELETE CASCADE,
    anomaly_event_id  INTEGER NOT NULL REFERENCES anomaly_event ON DELETE CASCADE,
    state             TEXT NOT NULL CHECK (state IN ('pending', 'sent', 'failed', 'suppressed')),
    -- Why it is not sent at once.
    held              TEXT CHECK (held IN ('quiet', 'digest', 'flood')),
    -- The digest that it goes out with: the largest number of an event in it.
    digest            INTEGER,
    created_at        INTEGER NOT NULL,
    -- Not before this moment.
    due_at            INTEGER NOT NULL,
    attempts          INTEGER NOT NULL DEFAULT 0 CHECK (attempts >= 0),
    first_attempted_at INTEGER,
    attempted_at      INTEGER,
    sent_at           INTEGER,
    -- Of the latest attempt that failed, or why it is not sent at all.
    error             TEXT,
    -- What the receiver was told in the latest attempt, where it knows an alarm by its labels.
    told_kind         TEXT,
    told_severity     TEXT, due_at_text TEXT, attempted_at_text TEXT, sent_at_text TEXT,
    UNIQUE (delivery_route_id, anomaly_event_id)
) STRICT;
CREATE INDEX delivery_by_event ON delivery (anomaly_event_id);
CREATE INDEX delivery_pending ON delivery (delivery_route_id, due_at) WHERE state = 'pending';
CREATE INDEX delivery_sent ON delivery (delivery_route_id, sent_at) WHERE state = 'sent';
CREATE TABLE run_friction (
    run_id INTEGER PRIMARY KEY REFERENCES run ON DELETE CASCADE,
    -- BLAKE3 of what its indices were computed from: its baselines, itself and the motion before it. Indices of another
    -- basis are computed anew. NULL where no joint has a baseline for it.
    basis  BLOB CHECK (length(basis) = 32)
) STRICT;
CREATE TABLE run_friction_points (
    run_id INTEGER NOT NULL REFERENCES run_friction ON DELETE CASCADE,
    joint  INTEGER NOT NULL CHECK (joint >= 1),
    points INTEGER NOT NULL CHECK (points >= 0),
    PRIMARY KEY (run_id, joint)
) STRICT, WITHOUT ROWID;
CREATE TRIGGER run_friction_is_looked_at_again AFTER UPDATE OF status ON run
WHEN NEW.status <> OLD.status
BEGIN
    DELETE FROM run_friction WHERE run_id = NEW.run_id;
END;
CREATE TABLE friction_baseline (
    friction_baseline_id INTEGER PRIMARY KEY AUTOINCREMENT,
    robot_id         INTEGER NOT NULL REFERENCES robot ON DELETE CASCADE,
    joint            INTEGER NOT NULL CHECK (joint >= 1),
    -- Ordinal of the joint's epoch by its first test, from 0.
    epoch            INTEGER NOT NULL CHECK (epoch >= 0),
    cause            TEXT NOT NULL CHECK (cause IN ('first_test', 'maintenance', 'description')),
    -- No foreign key: what is said of a baseline outlives a wrong entry of maintenance.
    maintenance_id   INTEGER,
    begins_at        INTEGER NOT NULL,
    basis            BLOB NOT NULL CHECK (length(basis) = 32),
    -- The held map by level, a JSON array of {"speed_fraction", "warm_nm", "cold_nm"}; NULL where there is none.
    levels           TEXT CHECK (json_valid(levels)),
    -- Why there is no map.
    remark           TEXT,
    -- Wall time.
    formed_at        INTEGER NOT NULL DEFAULT (CAST(unixepoch('subsec') * 1000000 AS INTEGER)),
    replaced_at      INTEGER,
    replaced_because TEXT, begins_at_text TEXT, formed_at_text TEXT, replaced_at_text TEXT,
    CHECK ((replaced_at IS NULL) = (replaced_because IS NULL))
) STRICT;
CREATE UNIQUE INDEX friction_baseline_in_force ON friction_baseline (robot_id, joint, epoch) WHERE replaced_at IS NULL;
CREATE INDEX friction_baseline_by_robot ON friction_baseline (robot_id);
CREATE TABLE friction_baseline_run (
    friction_baseline_id INTEGER NOT NULL REFERENCES friction_baseline ON DELETE CASCADE,
    run_id               INTEGER NOT NULL,
    PRIMARY KEY (friction_baseline_id, run_id)
) STRICT, WITHOUT ROWID;
CREATE INDEX friction_baseline_by_run ON friction_baseline_run (run_id);
CREATE TRIGGER maintenance_changes_history AFTER INSERT ON maintenance
BEGIN
    UPDATE robot SET history = history + 1 WHERE robot_id = NEW.robot_id;
END;
CREATE TRIGGER maintenance_taken_back_changes_history AFTER DELETE ON maintenance
BEGIN
    UPDATE robot SET history = history + 1 WHERE robot_id = OLD.robot_id;
END;
CREATE TABLE cycle_friction_level (
    cycle_id       INTEGER NOT NULL REFERENCES cycle ON DELETE CASCADE,
    joint          INTEGER NOT NULL CHECK (joint >= 1),
    -- Mean time of the points since the start of the recording.
    minute         REAL NOT NULL,
    -- Mean over the levels of the natural logarithm of half the difference between both directions.
    ln_torque      REAL NOT NULL,
    -- Mean over the levels of half the sum of both directions.
    offset_nm      REAL NOT NULL,
    levels         INTEGER NOT NULL CHECK (levels >= 1),
    -- Mean over the levels.
    speed_fraction REAL NOT NULL,
    PRIMARY KEY (cycle_id, joint)
) STRICT, WITHOUT ROWID;
CREATE VIEW cycle_friction AS
SELECT robot.name AS robot,
       cycle.run_id,
       cycle.number AS cycle,
       level.joint,
       level.minute,
       level.ln_torque,
       level.offset_nm,
       level.levels,
       level.speed_fraction
FROM cycle_friction_level AS level
JOIN cycle USING (cycle_id)
JOIN run USING (run_id)
JOIN robot USING (robot_id);
CREATE INDEX anomaly_by_open_run ON anomaly (open_run_id) WHERE open_run_id IS NOT NULL;
CREATE TRIGGER open_run_changes_history AFTER UPDATE OF status ON run
WHEN OLD.status = 'streaming' AND NEW.status NOT IN ('streaming', 'complete')
     AND EXISTS (SELECT 1 FROM anomaly WHERE anomaly.open_run_id = OLD.run_id)
BEGIN
    UPDATE robot SET history = history + 1 WHERE robot_id = OLD.robot_id;
END;
CREATE TRIGGER open_run_leaves_history BEFORE DELETE ON run
WHEN OLD.status <> 'complete' AND EXISTS (SELECT 1 FROM anomaly WHERE anomaly.open_run_id = OLD.run_id)
BEGIN
    UPDATE robot SET history = history + 1 WHERE robot_id = OLD.robot_id;
END;
CREATE TABLE channel_response (
    run_id     INTEGER PRIMARY KEY REFERENCES run ON DELETE CASCADE,
    parameters TEXT NOT NULL,
    numbers    BLOB NOT NULL
) STRICT;
CREATE TRIGGER run_opens_again AFTER UPDATE OF status ON run
WHEN OLD.status = 'complete' AND NEW.status = 'streaming'
BEGIN
    DELETE FROM warmup_fit WHERE run_id = OLD.run_id;
    DELETE FROM parameter_statistic WHERE run_id = OLD.run_id;
    DELETE FROM run_joint_summary WHERE run_id = OLD.run_id;
    DELETE FROM run_friction_index WHERE run_id = OLD.run_id;
    DELETE FROM production_summary WHERE run_id = OLD.run_id;
    DELETE FROM friction_speed_fit
    WHERE cycle_id IN (SELECT cycle.cycle_id FROM cycle WHERE cycle.run_id = OLD.run_id);
    DELETE FROM cycle_friction_level
    WHERE cycle_id IN (SELECT cycle.cycle_id FROM cycle WHERE cycle.run_id = OLD.run_id);
END;
CREATE TRIGGER run_times_as_text AFTER INSERT ON run
BEGIN
    UPDATE run
    SET started_at_text = strftime('%Y-%m-%dT%H:%M:%fZ', NEW.started_at / 1000000.0, 'unixepoch'),
        retry_asked_at_text = strftime('%Y-%m-%dT%H:%M:%fZ', NEW.retry_asked_at / 1000000.0, 'unixepoch')
    WHERE run_id = NEW.run_id;
END;
CREATE TRIGGER run_times_change AFTER UPDATE OF started_at, retry_asked_at ON run
BEGIN
    UPDATE run
    SET started_at_text = strftime('%Y-%m-%dT%H:%M:%fZ', NEW.started_at / 1000000.0, 'unixepoch'),
        retry_asked_at_text = strftime('%Y-%m-%dT%H:%M:%fZ', NEW.retry_asked_at / 1000000.0, 'unixepoch')
    WHERE run_id = NEW.run_id;
END;
CREATE TRIGGER cycle_times_as_text AFTER INSERT ON cycle
BEGIN
    UPDATE cycle
    SET started_at_text = strftime('%Y-%m-%dT%H:%M:%fZ', NEW.started_at / 1000000.0, 'unixepoch')
    WHERE cycle_id = NEW.cycle_id;
END;
CREATE TRIGGER cycle_times_change AFTER UPDATE OF started_at ON cycle
BEGIN
    UPDATE cycle
    SET started_at_text = strftime('%Y-%m-%dT%H:%M:%fZ', NEW.started_at / 1000000.0, 'unixepoch')
    WHERE cycle_id = NEW.cycle_id;
END;
CREATE TRIGGER fault_times_as_text AFTER INSERT ON fault
BEGIN
    UPDATE fault
    SET first_at_text = strftime('%Y-%m-%dT%H:%M:%fZ', NEW.first_at / 1000000.0, 'unixepoch'),
        last_at_text = strftime('%Y-%m-%dT%H:%M:%fZ', NEW.last_at / 1000000.0, 'unixepoch')
    WHERE fault_id = NEW.fault_id;
END;
CREATE TRIGGER fault_times_change AFTER UPDATE OF first_at, last_at ON fault
BEGIN
    UPDATE fault
    SET first_at_text = strftime('%Y-%m-%dT%H:%M:%fZ', NEW.first_at / 1000000.0, 'unixepoch'),
        last_at_text = strftime('%Y-%m-%dT%H:%M:%fZ', NEW.last_at / 1000000.0, 'unixepoch')
    WHERE fault_id = NEW.fault_id;
END;
CREATE TRIGGER dismissal_times_as_text AFTER INSERT ON dismissal
BEGIN
    UPDATE dismissal
    SET dismissed_at_text = strftime('%Y-%m-%dT%H:%M:%fZ', NEW.dismissed_at / 1000000.0, 'unixepoch')
    WHERE dismissal_id = NEW.dismissal_id;
END;
CREATE TRIGGER dismissal_times_change AFTER UPDATE OF dismissed_at ON dismissal
BEGIN
    UPDATE dismissal
    SET dismissed_at_text = strftime('%Y-%m-%dT%H:%M:%fZ', NEW.dismissed_at / 1000000.0, 'unixepoch')
    WHERE dismissal_id = NEW.dismissal_id;
END;
CREATE TRIGGER conclusion_fault_times_as_text AFTER INSERT ON conclusion_fault
BEGIN
    UPDATE conclusion_fault
    SET first_at_text = strftime('%Y-%m-%dT%H:%M:%fZ', NEW.first_at / 1000000.0, 'unixepoch'),
        last_at_text = strftime('%Y-%m-%dT%H:%M:%fZ', NEW.last_at / 1000000.0, 'unixepoch')
    WHERE robot_id = NEW.robot_id;
END;
CREATE TRIGGER conclusion_fault_times_change AFTER UPDATE OF first_at, last_at ON conclusion_fault
BEGIN
    UPDATE conclusion_fault
    SET first_at_text = strftime('%Y-%m-%dT%H:%M:%fZ', NEW.first_at / 1000000.0, 'unixepoch'),
        last_at_text = strftime('%Y-%m-%dT%H:%M:%fZ', NEW.last_at / 1000000.0, 'unixepoch')
    WHERE robot_id = NEW.robot_id;
END;
CREATE TRIGGER anomaly_times_as_text AFTER INSERT ON anomaly
BEGIN
    UPDATE anomaly
    SET first_seen_at_text = strftime('%Y-%m-%dT%H:%M:%fZ', NEW.first_seen_at / 1000000.0, 'unixepoch'),
        last_seen_at_text = strftime('%Y-%m-%dT%H:%M:%fZ', NEW.last_seen_at / 1000000.0, 'unixepoch'),
        onset_at_text = strftime('%Y-%m-%dT%H:%M:%fZ', NEW.onset_at / 1000000.0, 'unixepoch'),
        shelved_until_text = strftime('%Y-%m-%dT%H:%M:%fZ', NEW.shelved_until / 1000000.0, 'unixepoch')
    WHERE anomaly_id = NEW.anomaly_id;
END;
CREATE TRIGGER anomaly_times_change AFTER UPDATE OF first_seen_at, last_seen_at, onset_at, shelved_until ON anomaly
BEGIN
    UPDATE anomaly
    SET first_seen_at_text = strftime('%Y-%m-%dT%H:%M:%fZ', NEW.first_seen_at / 1000000.0, 'unixepoch'),
        last_seen_at_text = strftime('%Y-%m-%dT%H:%M:%fZ', NEW.last_seen_at / 1000000.0, 'unixepoch'),
        onset_at_text = strftime('%Y-%m-%dT%H:%M:%fZ', NEW.onset_at / 1000000.0, 'unixepoch'),
        shelved_until_text = strftime('%Y-%m-%dT%H:%M:%fZ', NEW.shelved_until / 1000000.0, 'unixepoch')
    WHERE anomaly_id = NEW.anomaly_id;
END;
CREATE TRIGGER anomaly_event_times_as_text AFTER INSERT ON anomaly_event
BEGIN
    UPDATE anomaly_event
    SET at_text = strftime('%Y-%m-%dT%H:%M:%fZ', NEW.at / 1000000.0, 'unixepoch')
    WHERE anomaly_event_id = NEW.anomaly_event_id;
END;
CREATE TRIGGER anomaly_event_times_change AFTER UPDATE OF at ON anomaly_event
BEGIN
    UPDATE anomaly_event
    SET at_text = strftime('%Y-%m-%dT%H:%M:%fZ', NEW.at / 1000000.0, 'unixepoch')
    WHERE anomaly_event_id = NEW.anomaly_event_id;
END;
CREATE TRIGGER maintenance_times_as_text AFTER INSERT ON maintenance
BEGIN
    UPDATE maintenance
    SET at_text = strftime('%Y-%m-%dT%H:%M:%fZ', NEW.at / 1000000.0, 'unixepoch'),
        recorded_at_text = strftime('%Y-%m-%dT%H:%M:%fZ', NEW.recorded_at / 1000000.0, 'unixepoch')
    WHERE maintenance_id = NEW.maintenance_id;
END;
CREATE TRIGGER maintenance_times_change AFTER UPDATE OF at, recorded_at ON maintenance
BEGIN
    UPDATE maintenance
    SET at_text = strftime('%Y-%m-%dT%H:%M:%fZ', NEW.at / 1000000.0, 'unixepoch'),
        recorded_at_text = strftime('%Y-%m-%dT%H:%M:%fZ', NEW.recorded_at / 1000000.0, 'unixepoch')
    WHERE maintenance_id = NEW.maintenance_id;
END;
CREATE TRIGGER friction_baseline_times_as_text AFTER INSERT ON friction_baseline
BEGIN
    UPDATE friction_baseline
    SET begins_at_text = strftime('%Y-%m-%dT%H:%M:%fZ', NEW.begins_at / 1000000.0, 'unixepoch'),
        formed_at_text = strftime('%Y-%m-%dT%H:%M:%fZ', NEW.formed_at / 1000000.0, 'unixepoch'),
        replaced_at_text = strftime('%Y-%m-%dT%H:%M:%fZ', NEW.replaced_at / 1000000.0, 'unixepoch')
    WHERE friction_baseline_id = NEW.friction_baseline_id;
END;
CREATE TRIGGER friction_baseline_times_change AFTER UPDATE OF begins_at, formed_at, replaced_at ON friction_baseline
BEGIN
    UPDATE friction_baseline
    SET begins_at_text = strftime('%Y-%m-%dT%H:%M:%fZ', NEW.begins_at / 1000000.0, 'unixepoch'),
        formed_at_text = strftime('%Y-%m-%dT%H:%M:%fZ', NEW.formed_at / 1000000.0, 'unixepoch'),
        replaced_at_text = strftime('%Y-%m-%dT%H:%M:%fZ', NEW.replaced_at / 1000000.0, 'unixepoch')
    WHERE friction_baseline_id = NEW.friction_baseline_id;
END;
CREATE TRIGGER delivery_times_as_text AFTER INSERT ON delivery
BEGIN
    UPDATE delivery
    SET due_at_text = strftime('%Y-%m-%dT%H:%M:%fZ', NEW.due_at / 1000000.0, 'unixepoch'),
        attempted_at_text = strftime('%Y-%m-%dT%H:%M:%fZ', NEW.attempted_at / 1000000.0, 'unixepoch'),
        sent_at_text = strftime('%Y-%m-%dT%H:%M:%fZ', NEW.sent_at / 1000000.0, 'unixepoch')
    WHERE delivery_id = NEW.delivery_id;
END;
CREATE TRIGGER delivery_times_change AFTER UPDATE OF due_at, attempted_at, sent_at ON delivery
BEGIN
    UPDATE delivery
    SET due_at_text = strftime('%Y-%m-%dT%H:%M:%fZ', NEW.due_at / 1000000.0, 'unixepoch'),
        attempted_at_text = strftime('%Y-%m-%dT%H:%M:%fZ', NEW.attempted_at / 1000000.0, 'unixepoch'),
        sent_at_text = strftime('%Y-%m-%dT%H:%M:%fZ', NEW.sent_at / 1000000.0, 'unixepoch')
    WHERE delivery_id = NEW.delivery_id;
END;
CREATE VIEW cycles AS
SELECT cycle.run_id,
       robot.name AS robot,
       cycle.number AS cycle,
       cycle.started_at_text AS started_at,
       cycle.duration_s,
       cycle.rows,
       CASE WHEN cycle.doubtful THEN 'doubtful' ELSE cycle.status END AS status,
       cycle.reason,
       cycle.remarks,
       cycle.sample_rate_hz,
       cycle.cutoff_hz,
       cycle.samples,
       cycle.condition_number,
       cycle.scaled_condition_number,
       cycle.residual_std_nm,
       cycle.estimator,
       cycle.error_basis,
       cycle.estimator_reason
FROM cycle
JOIN run USING (run_id)
JOIN robot USING (robot_id);
CREATE VIEW quarantine AS
SELECT run.run_id,
       robot.name AS robot,
       run.source_name,
       run.source_path,
       CASE
           WHEN run.superseded_by_run_id IS NOT NULL THEN 'superseded'
           WHEN run.status = 'complete' THEN 'stored'
           WHEN run.status = 'streaming' THEN 'reading'
           WHEN fault.fault_id < (SELECT max(later.fault_id) FROM fault AS later WHERE later.run_id = run.run_id)
               THEN 'earlier'
           WHEN dismissal.dismissal_id IS NOT NULL THEN 'dismissed'
           ELSE 'open'
       END AS state,
       fault.problem,
       fault.line,
       fault.column_name,
       fault.byte,
       fault.value,
       fault.remedy,
       fault.cycles_stored,
       fault.tries,
       fault.first_at_text AS first_at,
       fault.last_at_text AS last_at,
       run.retry_asked_at_text AS retry_asked_at,
       run.superseded_by_run_id,
       fault.fault_id,
       dismissal.dismissed_at_text AS dismissed_at,
       dismissal.dismissed_by,
       dismissal.reason AS dismissal_reason
FROM fault
JOIN run USING (run_id)
JOIN robot USING (robot_id)
LEFT JOIN dismissal ON dismissal.fault_id = fault.fault_id AND dismissal.withdrawn_at IS NULL;
CREATE VIEW conclusion_faults AS
SELECT robot.name AS robot,
       conclusion_fault.reason,
       conclusion_fault.tries,
       conclusion_fault.first_at_text AS first_at,
       conclusion_fault.last_at_text AS last_at
FROM conclusion_fault
JOIN robot USING (robot_id);
CREATE VIEW cycle_parameters AS
SELECT robot.name AS robot,
       cycle.run_id,
       cycle.number AS cycle,
       model_parameter.joint,
       model_parameter.name AS parameter,
       cycle_parameter.value,
       cycle_parameter.std_error,
       model_parameter.unit,
       model_parameter.grouping,
       cycle_parameter.std_error / nullif(abs(cycle_parameter.value), 0) AS relative_std_error,
       cycle_parameter.degrees_of_freedom,
       cycle_parameter.value - cycle_parameter.half_width_95 AS interval_low,
       cycle_parameter.value + cycle_parameter.half_width_95 AS interval_high
FROM cycle_parameter
JOIN model_parameter USING (model_parameter_id)
JOIN cycle USING (cycle_id)
JOIN run USING (run_id)
JOIN robot USING (robot_id);
CREATE VIEW friction_map AS
SELECT robot.name AS robot,
       law.joint,
       level.speed_fraction,
       level.warm_nm,
       level.warm_std_error_nm,
       level.cold_nm,
       level.cold_std_error_nm,
       CASE WHEN law.thermal_source <> 'motor_temperature' THEN law.slow_min END AS slow_min,
       CASE WHEN law.thermal_source <> 'motor_temperature' THEN law.slow_std_error_min END AS slow_std_error_min,
       law.fast_min,
       law.fast_std_error_min,
       law.slow_share,
       law.slow_share_std_error,
       law.cooling_ratio,
       law.cooling_ratio_std_error,
       law.explained,
       law.relative_rmsd,
       law.runs,
       law.points,
       law.remarks,
       law.thermal_source,
       law.warm_degc,
       law.cold_degc,
       law.curvature,
       law.curvature_std_error,
       law.ambient_degc,
       law.coldness_1_k,
       law.coldness_std_error_1_k
FROM friction_law AS law
JOIN friction_level AS level USING (robot_id, joint)
JOIN robot USING (robot_id);
CREATE VIEW friction_index AS
SELECT robot.name AS robot,
       found.run_id,
       run.started_at_text AS started_at,
       found.joint,
       found.friction_index,
       found.friction_index_std_error,
       found.ambient_coldness,
       found.ambient_coldness_std_error,
       found.coldness_at_start,
       found.points,
       found.raw_index,
       found.short_run
FROM run_friction_index AS found
JOIN run USING (run_id)
JOIN robot USING (robot_id);
CREATE VIEW temperatures AS
SELECT robot.name AS robot,
       cycle.run_id,
       cycle.number AS cycle,
       ((cycle.started_at - run.started_at) / 1000000.0 + 0.5 * cycle.duration_s) / 60.0 AS minute,
       CASE WHEN found.joint = 0 THEN 'ambient' ELSE 'motor' END AS sensor,
       nullif(found.joint, 0) AS joint,
       found.temperature_degc
FROM cycle_temperature AS found
JOIN cycle USING (cycle_id)
JOIN run USING (run_id)
JOIN robot USING (robot_id);
CREATE VIEW baselines AS
SELECT robot.name AS robot,
       baseline.joint,
       baseline.epoch,
       baseline.cause,
       baseline.begins_at_text AS begins_at,
       of_run.run_id,
       run.started_at_text AS started_at,
       baseline.levels,
       baseline.remark
FROM friction_baseline AS baseline
JOIN robot USING (robot_id)
JOIN friction_baseline_run AS of_run USING (friction_baseline_id)
LEFT JOIN run ON run.run_id = of_run.run_id
WHERE baseline.replaced_at IS NULL;
CREATE VIEW baseline_changes AS
SELECT baseline.friction_baseline_id,
       robot.name AS robot,
       baseline.joint,
       baseline.epoch,
       baseline.cause,
       baseline.begins_at_text AS begins_at,
       '[' || ifnull((SELECT group_concat(of_run.run_id, ',') FROM friction_baseline_run AS of_run
                      WHERE of_run.friction_baseline_id = baseline.friction_baseline_id), '') || ']' AS run_ids,
       baseline.formed_at_text AS formed_at,
       baseline.replaced_at_text AS replaced_at,
       baseline.replaced_because
FROM friction_baseline AS baseline
JOIN robot USING (robot_id);
CREATE VIEW anomalies AS
SELECT anomaly.anomaly_id,
       robot.name AS robot,
       anomaly.first_run_id AS run_id,
       anomaly.first_cycle AS cycle,
       anomaly.joint,
       anomaly.kind,
       anomaly.quantity,
       anomaly.severity,
       anomaly.score,
       anomaly.threshold,
       anomaly.value,
       anomaly.baseline,
       anomaly.first_seen_at_text AS first_seen_at,
       anomaly.last_seen_at_text AS last_seen_at,
       anomaly.state,
       anomaly.message,
       anomaly.last_run_id,
       anomaly.peak_value,
       anomaly.onset_at_text AS onset_at,
       anomaly.onset_run_id,
       anomaly.onset_cycle,
       anomaly.odds,
       anomaly.alternatives,
       anomaly.peak_score,
       anomaly.shelved_until_text AS shelved_until,
       anomaly.ended,
       CASE WHEN anomaly.open_run_id IS NULL THEN 0 ELSE 1 END AS provisional
FROM anomaly
JOIN robot USING (robot_id)
WHERE NOT anomaly.withdrawn;
CREATE VIEW anomaly_history AS
SELECT anomaly_event.anomaly_event_id,
       anomaly_event.anomaly_id,
       robot.name AS robot,
       anomaly.joint,
       anomaly.kind,
       anomaly_event.at_text AS at,
       anomaly_event.what,
       anomaly_event.severity,
       anomaly_event.score,
       anomaly_event.value,
       anomaly_event.message,
       anomaly_event.who,
       anomaly_event.why,
       anomaly_event.run_id
FROM anomaly_event
JOIN anomaly USING (anomaly_id)
JOIN robot USING (robot_id);
CREATE VIEW maintenance_log AS
SELECT maintenance.maintenance_id,
       robot.name AS robot,
       maintenance.joint,
       maintenance.at_text AS at,
       maintenance.what,
       maintenance.who,
       maintenance.recorded_at_text AS recorded_at
FROM maintenance
JOIN robot USING (robot_id);
CREATE VIEW deliveries AS
SELECT delivery.delivery_id,
       delivery_route.name AS route,
       'armwatch-' || database_identity.identity || '-' || delivery.anomaly_event_id AS key,
       anomaly_event.anomaly_id,
       delivery.anomaly_event_id,
       robot.name AS robot,
       anomaly.joint,
       anomaly_event.what,
       anomaly_event.severity,
       delivery.state,
       delivery.held,
       delivery.digest,
       delivery.due_at_text AS due_at,
       delivery.attempts,
       delivery.attempted_at_text AS attempted_at,
       delivery.sent_at_text AS sent_at,
       delivery.error
FROM delivery
JOIN delivery_route USING (delivery_route_id)
JOIN anomaly_event USING (anomaly_event_id)
JOIN anomaly USING (anomaly_id)
JOIN robot USING (robot_id)
CROSS JOIN database_identity;
CREATE VIEW production_checks AS
SELECT run.run_id,
       robot.name AS robot,
       cycle.number AS cycle,
       cycle.started_at_text AS started_at,
       cycle.duration_s,
       cycle.rows,
       production_check.joint,
       production_check.reference_run_id,
       production_check.moving_relative_rmsd,
       production_check.moving_rmsd_nm,
       production_check.relative_rmsd,
       production_check.rmsd_nm,
       production_check.friction_excess,
       production_check.friction_share,
       production_check.moving_samples,
       production_check.samples,
       CASE WHEN production_check.joint IS NULL THEN ifnull(cycle.reason, 'no model yet') END AS reason,
       production_check.estimator
FROM run
JOIN robot USING (robot_id)
JOIN cycle USING (run_id)
LEFT JOIN production_check USING (cycle_id)
WHERE run.kind = 'production' AND run.superseded_by_run_id IS NULL;
CREATE VIEW production_trend AS
SELECT robot.name AS robot,
       run.run_id,
       run.started_at_text AS started_at,
       production_summary.joint,
       production_summary.reference_run_id,
       production_summary.windows,
       production_summary.relative_rmsd AS moving_relative_rmsd,
       production_summary.friction_excess,
       production_summary.friction_share,
       of_test.relative_rmsd AS test_relative_rmsd
FROM production_summary
JOIN run USING (run_id)
JOIN robot USING (robot_id)
LEFT JOIN run_joint_summary AS of_test
          ON of_test.run_id = production_summary.reference_run_id AND of_test.joint = production_summary.joint
WHERE run.superseded_by_run_id IS NULL;
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
CREATE VIEW view_columns AS
SELECT view_name,
       column_name,
       position,
       type,
       unit,
       CASE WHEN null_when IS NULL THEN 0 ELSE 1 END AS nullable,
       null_when,
       meaning
FROM view_column;
CREATE TABLE log_factor (
    log_factor_id    INTEGER PRIMARY KEY,
    run_id           INTEGER NOT NULL REFERENCES run ON DELETE CASCADE,
    factor_layout_id INTEGER NOT NULL REFERENCES factor_layout,
    joint            INTEGER NOT NULL CHECK (joint >= 1),
    stage            TEXT NOT NULL CHECK (stage IN ('excitation', 'friction', 'warming', 'between')),
    motion           TEXT NOT NULL CHECK (motion IN ('moving', 'slow')),
    rows             INTEGER NOT NULL CHECK (rows >= 1),
    factor           BLOB NOT NULL,
    UNIQUE (run_id, factor_layout_id, stage, motion, joint)
) STRICT;
CREATE INDEX log_factor_by_layout ON log_factor (factor_layout_id);
CREATE TRIGGER joined_window_goes AFTER DELETE ON cycle
WHEN OLD.factors_gone = 'joined'
BEGIN
    DELETE FROM log_factor WHERE run_id = OLD.run_id;
    UPDATE cycle SET factors_gone = 'removed' WHERE run_id = OLD.run_id AND factors_gone = 'joined';
END;
CREATE TRIGGER test_leaves_checks AFTER UPDATE OF status ON run
WHEN OLD.status = 'complete' AND NEW.status <> 'complete' AND OLD.kind = 'test'
BEGIN
    DELETE FROM production_check
    WHERE reference_run_id = OLD.run_id
          AND cycle_id IN (SELECT cycle_factor_layout.cycle_id FROM cycle_factor_layout);
    DELETE FROM production_summary
    WHERE reference_run_id = OLD.run_id
          AND run_id IN (SELECT cycle.run_id FROM cycle JOIN cycle_factor_layout USING (cycle_id)
                         WHERE cycle.run_id = production_summary.run_id);
END;
CREATE TABLE run_series (
    run_id  INTEGER PRIMARY KEY REFERENCES run ON DELETE CASCADE,
    numbers BLOB NOT NULL
) STRICT;
CREATE TRIGGER run_series_goes_with_status AFTER UPDATE OF status ON run
WHEN NEW.status <> OLD.status
BEGIN
    DELETE FROM run_series WHERE run_id = NEW.run_id;
END;
CREATE TRIGGER run_series_goes_with_new_cycle AFTER INSERT ON cycle
BEGIN
    DELETE FROM run_series WHERE run_id = NEW.run_id;
END;
CREATE TRIGGER run_series_goes_with_cycle AFTER DELETE ON cycle
BEGIN
    DELETE FROM run_series WHERE run_id = OLD.run_id;
END;
CREATE TRIGGER run_series_goes_with_changed_cycle AFTER UPDATE OF run_id, number, status, doubtful ON cycle
BEGIN
    DELETE FROM run_series WHERE run_id IN (OLD.run_id, NEW.run_id);
END;
CREATE TRIGGER run_series_goes_with_new_rmsd AFTER INSERT ON torque_rmsd
WHEN NEW.stage = 'all' AND NEW.verification = 'self'
BEGIN
    DELETE FROM run_series WHERE run_id = (SELECT cycle.run_id FROM cycle WHERE cycle.cycle_id = NEW.cycle_id);
END;
CREATE TRIGGER run_series_goes_with_changed_rmsd AFTER UPDATE ON torque_rmsd
WHEN 'all' IN (OLD.stage, NEW.stage)
BEGIN
    DELETE FROM run_series
    WHERE run_id IN (SELECT cycle.run_id FROM cycle WHERE cycle.cycle_id IN (OLD.cycle_id, NEW.cycle_id));
END;
CREATE TRIGGER run_series_goes_with_rmsd AFTER DELETE ON torque_rmsd
WHEN OLD.stage = 'all' AND OLD.verification = 'self'
BEGIN
    DELETE FROM run_series WHERE run_id = (SELECT cycle.run_id FROM cycle WHERE cycle.cycle_id = OLD.cycle_id);
END;
CREATE TRIGGER run_series_goes_with_new_level AFTER INSERT ON cycle_friction_level
BEGIN
    DELETE FROM run_series WHERE run_id = (SELECT cycle.run_id FROM cycle WHERE cycle.cycle_id = NEW.cycle_id);
END;
CREATE TRIGGER run_series_goes_with_changed_level AFTER UPDATE ON cycle_friction_level
BEGIN
    DELETE FROM run_series
    WHERE run_id IN (SELECT cycle.run_id FROM cycle WHERE cycle.cycle_id IN (OLD.cycle_id, NEW.cycle_id));
END;
CREATE TRIGGER run_series_goes_with_level AFTER DELETE ON cycle_friction_level
BEGIN
    DELETE FROM run_series WHERE run_id = (SELECT cycle.run_id FROM cycle WHERE cycle.cycle_id = OLD.cycle_id);
END;
CREATE TRIGGER run_series_goes_with_new_parameter AFTER INSERT ON parameter_statistic
BEGIN
    DELETE FROM run_series WHERE run_id = NEW.run_id;
END;
CREATE TRIGGER run_series_goes_with_changed_parameter AFTER UPDATE ON parameter_statistic
BEGIN
    DELETE FROM run_series WHERE run_id IN (OLD.run_id, NEW.run_id);
END;
CREATE TRIGGER run_series_goes_with_parameter AFTER DELETE ON parameter_statistic
BEGIN
    DELETE FROM run_series WHERE run_id = OLD.run_id;
END;
CREATE INDEX run_complete_test ON run (robot_id, started_at, run_id) WHERE kind = 'test' AND status = 'complete';
CREATE INDEX run_unfinished ON run (run_id) WHERE status = 'streaming';
CREATE INDEX cycle_refused ON cycle (run_id) WHERE status = 'refused';
CREATE INDEX cycle_with_factors ON cycle (run_id, number) WHERE factors_gone IS NULL AND status = 'complete';
CREATE TRIGGER run_series_goes_with_new_summary AFTER INSERT ON run_joint_summary
BEGIN
    DELETE FROM run_series WHERE run_id = NEW.run_id;
END;
CREATE TRIGGER run_series_goes_with_changed_summary AFTER UPDATE ON run_joint_summary
BEGIN
    DELETE FROM run_series WHERE run_id IN (OLD.run_id, NEW.run_id);
END;
CREATE TRIGGER run_series_goes_with_summary AFTER DELETE ON run_joint_summary
BEGIN
    DELETE FROM run_series WHERE run_id = OLD.run_id;
END;
CREATE TRIGGER run_series_goes_with_new_index AFTER INSERT ON run_friction_index
BEGIN
    DELETE FROM run_series WHERE run_id = NEW.run_id;
END;
CREATE TRIGGER run_series_goes_with_changed_index AFTER UPDATE ON run_friction_index
BEGIN
    DELETE FROM run_series WHERE run_id IN (OLD.run_id, NEW.run_id);
END;
CREATE TRIGGER run_series_goes_with_index AFTER DELETE ON run_friction_index
BEGIN
    DELETE FROM run_series WHERE run_id = OLD.run_id;
END;
CREATE TABLE run_friction_series (
    robot_id       INTEGER NOT NULL REFERENCES robot ON DELETE CASCADE,
    run_id         INTEGER NOT NULL REFERENCES run ON DELETE CASCADE,
    speed_fraction REAL NOT NULL,
    numbers        BLOB NOT NULL,
    PRIMARY KEY (run_id, speed_fraction)
) STRICT;
CREATE INDEX run_friction_series_by_robot ON run_friction_series (robot_id);
CREATE TRIGGER run_friction_series_goes_with_run AFTER UPDATE OF status, robot_id ON run
WHEN NEW.status <> OLD.status OR NEW.robot_id IS NOT OLD.robot_id
BEGIN
    DELETE FROM run_friction_series WHERE run_id = NEW.run_id;
END;
CREATE TRIGGER run_friction_series_goes_with_cycle AFTER DELETE ON cycle
BEGIN
    DELETE FROM run_friction_series WHERE run_id = OLD.run_id;
END;
CREATE TRIGGER run_friction_series_goes_with_changed_cycle AFTER UPDATE OF run_id, number, status, doubtful ON cycle
BEGIN
    DELETE FROM run_friction_series WHERE run_id IN (OLD.run_id, NEW.run_id);
END;
CREATE TRIGGER run_friction_series_goes_with_new_point AFTER INSERT ON friction_point
BEGIN
    DELETE FROM run_friction_series
    WHERE run_id = (SELECT cycle.run_id FROM cycle WHERE cycle.cycle_id = NEW.cycle_id);
END;
CREATE TRIGGER run_friction_series_goes_with_changed_point AFTER UPDATE ON friction_point
BEGIN
    DELETE FROM run_friction_series
    WHERE run_id IN (SELECT cycle.run_id FROM cycle WHERE cycle.cycle_id IN (OLD.cycle_id, NEW.cycle_id));
END;
CREATE TRIGGER run_friction_series_goes_with_point AFTER DELETE ON friction_point
BEGIN
    DELETE FROM run_friction_series
    WHERE run_id = (SELECT cycle.run_id FROM cycle WHERE cycle.cycle_id = OLD.cycle_id);
END;
CREATE TRIGGER run_friction_series_goes_with_new_refusal AFTER INSERT ON cycle_refusal
BEGIN
    DELETE FROM run_friction_series
    WHERE run_id = (SELECT cycle.run_id FROM cycle WHERE cycle.cycle_id = NEW.cycle_id);
END;
CREATE TRIGGER run_friction_series_goes_with_changed_refusal AFTER UPDATE OF cycle_id ON cycle_refusal
BEGIN
    DELETE FROM run_friction_series
    WHERE run_id IN (SELECT cycle.run_id FROM cycle WHERE cycle.cycle_id IN (OLD.cycle_id, NEW.cycle_id));
END;
CREATE TRIGGER run_friction_series_goes_with_refusal AFTER DELETE ON cycle_refusal
BEGIN
    DELETE FROM run_friction_series
    WHERE run_id = (SELECT cycle.run_id FROM cycle WHERE cycle.cycle_id = OLD.cycle_id);
END;
CREATE INDEX run_by_start_text ON run (started_at_text);
CREATE INDEX cycle_shown_as_refused ON cycle (run_id)
WHERE CASE WHEN doubtful THEN 'doubtful' ELSE status END COLLATE BINARY = 'refused';
CREATE INDEX cycle_with_remarks ON cycle (started_at_text)
WHERE remarks IS NOT NULL OR CASE WHEN doubtful THEN 'doubtful' ELSE status END COLLATE BINARY = 'doubtful';
CREATE TABLE window_evidence (
    cycle_id INTEGER PRIMARY KEY REFERENCES cycle ON DELETE CASCADE,
    numbers  BLOB NOT NULL
) STRICT;
CREATE TABLE log_evidence (
    run_id           INTEGER NOT NULL REFERENCES run ON DELETE CASCADE,
    reference_run_id INTEGER NOT NULL REFERENCES run ON DELETE CASCADE,
    numbers          BLOB NOT NULL,
    PRIMARY KEY (run_id, reference_run_id)
) STRICT, WITHOUT ROWID;
CREATE INDEX log_evidence_by_reference ON log_evidence (reference_run_id);
CREATE TRIGGER check_takes_evidence AFTER DELETE ON production_check
BEGIN
    DELETE FROM window_evidence WHERE cycle_id = OLD.cycle_id;
END;
CREATE TRIGGER summary_takes_evidence AFTER DELETE ON production_summary
BEGIN
    DELETE FROM log_evidence WHERE run_id = OLD.run_id AND reference_run_id = OLD.reference_run_id;
END;
CREATE TABLE run_brief (
    run_id     INTEGER PRIMARY KEY REFERENCES run ON DELETE CASCADE,
    joints     BLOB NOT NULL,
    brief      BLOB NOT NULL,
    judgements BLOB NOT NULL
) STRICT;
CREATE TRIGGER run_brief_goes_with_series AFTER DELETE ON run_series
BEGIN
    DELETE FROM run_brief WHERE run_id = OLD.run_id;
END;
CREATE TABLE channel_noise (
    cycle_id       INTEGER NOT NULL REFERENCES cycle ON DELETE CASCADE,
    joint          INTEGER NOT NULL CHECK (joint >= 1),
    noise_nm       REAL NOT NULL,
    relative_noise REAL NOT NULL,
    PRIMARY KEY (cycle_id, joint)
) STRICT, WITHOUT ROWID;
CREATE VIEW torque_noise AS
SELECT robot.name   AS robot,
       run.run_id   AS run_id,
       cycle.number AS cycle,
       noise.joint  AS joint,
       noise.noise_nm,
       noise.relative_noise
FROM channel_noise AS noise
JOIN cycle USING (cycle_id)
JOIN run USING (run_id)
JOIN robot USING (robot_id);
CREATE TABLE host_session (
    host_session_id INTEGER PRIMARY KEY AUTOINCREMENT,
    -- The name that --host or [cluster] gives; empty without one.
    host        TEXT NOT NULL,
    kind        TEXT NOT NULL CHECK (kind IN ('daemon', 'command')),
    version     TEXT NOT NULL,
    started_at  INTEGER NOT NULL,
    seen_at     INTEGER NOT NULL,
    -- When the lease ends unless it is renewed.
    alive_until INTEGER NOT NULL,
    ended_at    INTEGER,
    end_reason  TEXT CHECK (end_reason IN ('stopped', 'restarted', 'lease_ended')),
    started_at_text TEXT,
    seen_at_text TEXT,
    CHECK ((ended_at IS NULL) = (end_reason IS NULL))
) STRICT;
CREATE TRIGGER host_session_times_as_text AFTER INSERT ON host_session
BEGIN
    UPDATE host_session
    SET started_at_text = strftime('%Y-%m-%dT%H:%M:%fZ', NEW.started_at / 1000000.0, 'unixepoch'),
        seen_at_text = strftime('%Y-%m-%dT%H:%M:%fZ', NEW.seen_at / 1000000.0, 'unixepoch')
    WHERE host_session_id = NEW.host_session_id;
END;
CREATE TRIGGER host_session_times_change AFTER UPDATE OF started_at, seen_at ON host_session
BEGIN
    UPDATE host_session
    SET started_at_text = strftime('%Y-%m-%dT%H:%M:%fZ', NEW.started_at / 1000000.0, 'unixepoch'),
        seen_at_text = strftime('%Y-%m-%dT%H:%M:%fZ', NEW.seen_at / 1000000.0, 'unixepoch')
    WHERE host_session_id = NEW.host_session_id;
END;
CREATE INDEX host_session_alive ON host_session (alive_until) WHERE ended_at IS NULL;
CREATE INDEX host_session_by_host ON host_session (host, host_session_id);
CREATE TABLE claim (
    kind            TEXT NOT NULL CHECK (kind IN ('export', 'run', 'robot', 'route')),
    subject         TEXT NOT NULL,
    host_session_id INTEGER NOT NULL REFERENCES host_session ON DELETE CASCADE,
    claimed_at      INTEGER NOT NULL,
    PRIMARY KEY (kind, subject)
) STRICT, WITHOUT ROWID;
CREATE INDEX claim_by_session ON claim (host_session_id);
CREATE INDEX run_by_session ON run (host_session_id) WHERE host_session_id IS NOT NULL;
CREATE INDEX run_by_bytes ON run (source_bytes);
CREATE VIEW hosts AS
SELECT latest.host,
       CASE WHEN latest.ended_at IS NOT NULL THEN 'ended'
            ELSE 'at_work' END AS state,
       latest.end_reason,
       latest.version,
       latest.started_at_text AS started_at,
       latest.seen_at_text AS seen_at,
       (SELECT count(*) FROM claim WHERE claim.host_session_id = latest.host_session_id AND claim.kind = 'run') AS runs_in_work,
       (SELECT count(*) FROM host_session AS own JOIN run USING (host_session_id) WHERE own.host = latest.host) AS runs
FROM host_session AS latest
WHERE latest.kind = 'daemon'
  AND latest.host_session_id = (SELECT max(own.host_session_id) FROM host_session AS own
                                WHERE own.host = latest.host AND own.kind = 'daemon');
CREATE INDEX anomaly_by_settled_history ON anomaly (settled_history_id) WHERE settled_history_id IS NOT NULL;
CREATE INDEX anomaly_not_settled ON anomaly (robot_id, anomaly_id) WHERE settled_history_id IS NULL;
CREATE TRIGGER settled_history_goes_with_new_test AFTER INSERT ON run
WHEN NEW.status = 'complete' AND NEW.kind = 'test'
BEGIN
    DELETE FROM settled_history WHERE robot_id = NEW.robot_id AND follows_until >= NEW.started_at;
END;
CREATE TRIGGER settled_history_goes_with_changed_test AFTER UPDATE OF robot_id, kind, status, started_at, cycles_stored, robot_model_id, figures_hash ON run
WHEN 'complete' IN (OLD.status, NEW.status) AND 'test' IN (OLD.kind, NEW.kind)
BEGIN
    DELETE FROM settled_history WHERE robot_id = OLD.robot_id AND follows_until >= OLD.started_at;
    DELETE FROM settled_history WHERE robot_id = NEW.robot_id AND follows_until >= NEW.started_at;
END;
CREATE TRIGGER settled_history_goes_with_test AFTER DELETE ON run
WHEN OLD.status = 'complete' AND OLD.kind = 'test'
BEGIN
    DELETE FROM settled_history WHERE robot_id = OLD.robot_id AND follows_until >= OLD.started_at;
END;
CREATE TRIGGER settled_history_goes_with_brief AFTER DELETE ON run_brief
BEGIN
    DELETE FROM settled_history
    WHERE robot_id = (SELECT run.robot_id FROM run WHERE run.run_id = OLD.run_id)
          AND follows_until >= (SELECT run.started_at FROM run WHERE run.run_id = OLD.run_id);
END;
CREATE TRIGGER settled_history_goes_with_changed_reason AFTER UPDATE OF reason ON cycle
WHEN 'refused' IN (OLD.status, NEW.status)
BEGIN
    DELETE FROM settled_history
    WHERE robot_id = (SELECT run.robot_id FROM run WHERE run.run_id = NEW.run_id)
          AND follows_until >= (SELECT run.started_at FROM run WHERE run.run_id = NEW.run_id);
END;
CREATE TRIGGER settled_history_goes_with_new_refusal AFTER INSERT ON cycle_refusal
BEGIN
    DELETE FROM settled_history
    WHERE robot_id = (SELECT run.robot_id FROM cycle JOIN run USING (run_id) WHERE cycle.cycle_id = NEW.cycle_id)
          AND follows_until >= (SELECT run.started_at FROM cycle JOIN run USING (run_id) WHERE cycle.cycle_id = NEW.cycle_id);
END;
CREATE TRIGGER settled_history_goes_with_changed_refusal AFTER UPDATE ON cycle_refusal
BEGIN
    DELETE FROM settled_history
    WHERE robot_id = (SELECT run.robot_id FROM cycle JOIN run USING (run_id) WHERE cycle.cycle_id = OLD.cycle_id)
          AND follows_until >= (SELECT run.started_at FROM cycle JOIN run USING (run_id) WHERE cycle.cycle_id = OLD.cycle_id);
    DELETE FROM settled_history
    WHERE robot_id = (SELECT run.robot_id FROM cycle JOIN run USING (run_id) WHERE cycle.cycle_id = NEW.cycle_id)
          AND follows_until >= (SELECT run.started_at FROM cycle JOIN run USING (run_id) WHERE cycle.cycle_id = NEW.cycle_id);
END;
CREATE TRIGGER settled_history_goes_with_refusal AFTER DELETE ON cycle_refusal
BEGIN
    DELETE FROM settled_history
    WHERE robot_id = (SELECT run.robot_id FROM cycle JOIN run USING (run_id) WHERE cycle.cycle_id = OLD.cycle_id)
          AND follows_until >= (SELECT run.started_at FROM cycle JOIN run USING (run_id) WHERE cycle.cycle_id = OLD.cycle_id);
END;
CREATE TRIGGER settled_history_goes_with_new_response AFTER INSERT ON channel_response
BEGIN
    DELETE FROM settled_history
    WHERE robot_id = (SELECT run.robot_id FROM run WHERE run.run_id = NEW.run_id)
          AND follows_until >= (SELECT run.started_at FROM run WHERE run.run_id = NEW.run_id);
END;
CREATE TRIGGER settled_history_goes_with_changed_response AFTER UPDATE ON channel_response
BEGIN
    DELETE FROM settled_history
    WHERE robot_id = (SELECT run.robot_id FROM run WHERE run.run_id = OLD.run_id)
          AND follows_until >= (SELECT run.started_at FROM run WHERE run.run_id = OLD.run_id);
    DELETE FROM settled_history
    WHERE robot_id = (SELECT run.robot_id FROM run WHERE run.run_id = NEW.run_id)
          AND follows_until >= (SELECT run.started_at FROM run WHERE run.run_id = NEW.run_id);
END;
CREATE TRIGGER settled_history_goes_with_response AFTER DELETE ON channel_response
BEGIN
    DELETE FROM settled_history
    WHERE robot_id = (SELECT run.robot_id FROM run WHERE run.run_id = OLD.run_id)
          AND follows_until >= (SELECT run.started_at FROM run WHERE run.run_id = OLD.run_id);
END;
CREATE TRIGGER settled_history_goes_with_new_work AFTER INSERT ON maintenance
BEGIN
    DELETE FROM settled_history WHERE robot_id = NEW.robot_id AND follows_until >= NEW.at;
END;
CREATE TRIGGER settled_history_goes_with_changed_work AFTER UPDATE ON maintenance
BEGIN
    DELETE FROM settled_history WHERE robot_id = OLD.robot_id AND follows_until >= OLD.at;
    DELETE FROM settled_history WHERE robot_id = NEW.robot_id AND follows_until >= NEW.at;
END;
CREATE TRIGGER settled_history_goes_with_work AFTER DELETE ON maintenance
BEGIN
    DELETE FROM settled_history WHERE robot_id = OLD.robot_id AND follows_until >= OLD.at;
END;
CREATE TABLE friction_plan (
    robot_id      INTEGER PRIMARY KEY REFERENCES robot ON DELETE CASCADE,
    follows_until INTEGER NOT NULL,
    basis         INTEGER NOT NULL,
    numbers       BLOB NOT NULL
) STRICT;
CREATE TRIGGER friction_plan_goes_with_new_test AFTER INSERT ON run
WHEN NEW.status = 'complete' AND NEW.kind = 'test'
BEGIN
    DELETE FROM friction_plan WHERE robot_id = NEW.robot_id AND follows_until >= NEW.started_at;
END;
CREATE TRIGGER friction_plan_goes_with_changed_test AFTER UPDATE OF robot_id, kind, status, started_at, robot_model_id, figures_hash ON run
WHEN 'complete' IN (OLD.status, NEW.status) AND 'test' IN (OLD.kind, NEW.kind)
BEGIN
    DELETE FROM friction_plan WHERE robot_id = OLD.robot_id AND follows_until >= OLD.started_at;
    DELETE FROM friction_plan WHERE robot_id = NEW.robot_id AND follows_until >= NEW.started_at;
END;
CREATE TRIGGER friction_plan_goes_with_test AFTER DELETE ON run
WHEN OLD.status = 'complete' AND OLD.kind = 'test'
BEGIN
    DELETE FROM friction_plan WHERE robot_id = OLD.robot_id AND follows_until >= OLD.started_at;
END;
CREATE TRIGGER friction_plan_goes_with_friction AFTER DELETE ON run_friction
BEGIN
    DELETE FROM friction_plan
    WHERE robot_id = (SELECT run.robot_id FROM run WHERE run.run_id = OLD.run_id)
          AND follows_until >= (SELECT run.started_at FROM run WHERE run.run_id = OLD.run_id);
END;
CREATE TRIGGER friction_plan_goes_with_new_work AFTER INSERT ON maintenance
BEGIN
    DELETE FROM friction_plan WHERE robot_id = NEW.robot_id AND follows_until >= NEW.at;
END;
CREATE TRIGGER friction_plan_goes_with_changed_work AFTER UPDATE ON maintenance
BEGIN
    DELETE FROM friction_plan WHERE robot_id = OLD.robot_id AND follows_until >= OLD.at;
    DELETE FROM friction_plan WHERE robot_id = NEW.robot_id AND follows_until >= NEW.at;
END;
CREATE TRIGGER friction_plan_goes_with_work AFTER DELETE ON maintenance
BEGIN
    DELETE FROM friction_plan WHERE robot_id = OLD.robot_id AND follows_until >= OLD.at;
END;
CREATE INDEX run_production ON run (robot_id, status, started_at, run_id) WHERE kind = 'production';
CREATE INDEX run_of_robot_by_start_text
ON run (robot_id, started_at_text, run_id, status, superseded_by_run_id, kind, model);
CREATE TABLE settled_history (
    settled_history_id INTEGER PRIMARY KEY AUTOINCREMENT,
    robot_id           INTEGER NOT NULL REFERENCES robot ON DELETE CASCADE,
    kind               TEXT NOT NULL CHECK (kind IN ('test', 'production')),
    runs               INTEGER NOT NULL CHECK (runs > 0),
    -- Start of the latest run that it follows from, microseconds since 1970.
    follows_until      INTEGER NOT NULL,
    basis              INTEGER NOT NULL,
    numbers            BLOB NOT NULL,
    UNIQUE (robot_id, kind, runs)
) STRICT;
CREATE INDEX settled_history_by_time ON settled_history (robot_id, follows_until);
CREATE TRIGGER settled_history_goes_with_new_log AFTER INSERT ON production_summary
BEGIN
    DELETE FROM settled_history
    WHERE kind = 'production' AND robot_id = (SELECT run.robot_id FROM run WHERE run.run_id = NEW.run_id)
          AND follows_until >= (SELECT run.started_at FROM run WHERE run.run_id = NEW.run_id);
END;
CREATE TRIGGER settled_history_goes_with_changed_log AFTER UPDATE ON production_summary
BEGIN
    DELETE FROM settled_history
    WHERE kind = 'production' AND robot_id = (SELECT run.robot_id FROM run WHERE run.run_id = NEW.run_id)
          AND follows_until >= (SELECT run.started_at FROM run WHERE run.run_id = NEW.run_id);
END;
CREATE TRIGGER settled_history_goes_with_log AFTER DELETE ON production_summary
BEGIN
    DELETE FROM settled_history
    WHERE kind = 'production' AND robot_id = (SELECT run.robot_id FROM run WHERE run.run_id = OLD.run_id)
          AND follows_until >= (SELECT run.started_at FROM run WHERE run.run_id = OLD.run_id);
END;
CREATE TRIGGER settled_history_goes_with_changed_work_run AFTER UPDATE OF robot_id, kind, status, started_at ON run
WHEN 'complete' IN (OLD.status, NEW.status) AND 'production' IN (OLD.kind, NEW.kind)
BEGIN
    DELETE FROM settled_history
    WHERE kind = 'production' AND robot_id = OLD.robot_id AND follows_until >= OLD.started_at;
    DELETE FROM settled_history
    WHERE kind = 'production' AND robot_id = NEW.robot_id AND follows_until >= NEW.started_at;
END;
CREATE TRIGGER settled_history_goes_with_work_run AFTER DELETE ON run
WHEN OLD.status = 'complete' AND OLD.kind = 'production'
BEGIN
    DELETE FROM settled_history
    WHERE kind = 'production' AND robot_id = OLD.robot_id AND follows_until >= OLD.started_at;
END;
CREATE TRIGGER settled_history_goes_with_error_of_test AFTER UPDATE OF relative_rmsd ON run_joint_summary
BEGIN
    DELETE FROM settled_history
    WHERE kind = 'production' AND robot_id = (SELECT run.robot_id FROM run WHERE run.run_id = NEW.run_id)
          AND follows_until >= (SELECT min(log.started_at)
                                FROM production_summary JOIN run AS log ON log.run_id = production_summary.run_id
                                WHERE production_summary.reference_run_id = NEW.run_id);
END;
CREATE TRIGGER settled_history_goes_with_test_without_error AFTER DELETE ON run_joint_summary
BEGIN
    DELETE FROM settled_history
    WHERE kind = 'production' AND robot_id = (SELECT run.robot_id FROM run WHERE run.run_id = OLD.run_id)
          AND follows_until >= (SELECT min(log.started_at)
                                FROM production_summary JOIN run AS log ON log.run_id = production_summary.run_id
                                WHERE production_summary.reference_run_id = OLD.run_id);
END;
CREATE TRIGGER settled_history_goes_with_test_with_error AFTER INSERT ON run_joint_summary
BEGIN
    DELETE FROM settled_history
    WHERE kind = 'production' AND robot_id = (SELECT run.robot_id FROM run WHERE run.run_id = NEW.run_id)
          AND follows_until >= (SELECT min(log.started_at)
                                FROM production_summary JOIN run AS log ON log.run_id = production_summary.run_id
                                WHERE production_summary.reference_run_id = NEW.run_id);
END;
CREATE INDEX anomaly_by_state ON anomaly (state, robot_id, severity) WHERE NOT withdrawn;
CREATE INDEX anomaly_in_force ON anomaly (robot_id, joint)
WHERE state NOT IN ('resolved', 'false_alarm') AND NOT withdrawn;
CREATE INDEX cycle_by_estimator ON cycle (estimator, estimator_wanted, run_id) WHERE samples IS NOT NULL;
CREATE TABLE attempt (
    work     TEXT NOT NULL CHECK (work IN ('program', 'export', 'conclusion', 'delivery')),
    -- Host, path, robot or message.
    subject  TEXT NOT NULL,
    attempts INTEGER NOT NULL CHECK (attempts >= 1),
    -- The process that made the latest attempt, as long as it may still be at it.
    process  INTEGER,
    -- The program that made them: another version begins to count anew.
    version  TEXT NOT NULL,
    -- What was to be read: another file, or one of which more cycles are stored by now, begins to count anew.
    inode    INTEGER NOT NULL DEFAULT 0,
    bytes    INTEGER NOT NULL DEFAULT 0,
    cycles   INTEGER NOT NULL DEFAULT 0,
    PRIMARY KEY (work, subject)
) STRICT, WITHOUT ROWID;
CREATE TABLE blocked_file (
    path        TEXT PRIMARY KEY,
    run_id      INTEGER REFERENCES run ON DELETE CASCADE,
    -- The robot that the name says, which may have no run yet.
    robot       TEXT,
    source_name TEXT NOT NULL,
    line        INTEGER CHECK (line >= 1),
    problem     TEXT NOT NULL,
    remedy      TEXT NOT NULL,
    blocked_at  TEXT NOT NULL DEFAULT (strftime('%Y-%m-%dT%H:%M:%fZ', 'now'))
) STRICT, WITHOUT ROWID;
CREATE INDEX blocked_file_by_run ON blocked_file (run_id);
CREATE INDEX blocked_file_by_robot ON blocked_file (robot);
CREATE VIEW blocked_files AS
SELECT blocked_file.robot,
       blocked_file.source_name,
       blocked_file.path AS source_path,
       blocked_file.run_id,
       blocked_file.line,
       blocked_file.problem,
       blocked_file.remedy,
       blocked_file.blocked_at,
       CASE WHEN blocked_file.line IS NULL THEN 'cannot be read since '
            ELSE 'cannot be read beyond line ' || blocked_file.line || ' since ' END
           || blocked_file.blocked_at || ': ' || blocked_file.problem AS message
FROM blocked_file;
CREATE TABLE unanswered_folder (
    -- The name that --host or [cluster] gives; empty without one.
    host      TEXT NOT NULL,
    folder    TEXT NOT NULL,
    -- When the daemon last looked into it, microseconds since 1970; NULL if not since its start.
    looked_at INTEGER,
    PRIMARY KEY (host, folder)
) STRICT, WITHOUT ROWID;
CREATE INDEX run_set_aside ON run (robot_id, run_id) WHERE set_aside IS NOT NULL;
CREATE VIEW runs AS
SELECT run.run_id,
       robot.name AS robot,
       run.started_at_text AS started_at,
       run.source_name,
       CASE WHEN NOT run.growing THEN lower(hex(run.content_hash)) END AS content_hash,
       run.rows,
       run.sample_rate_hz,
       run.cycles_stored AS cycles,
       CASE WHEN run.superseded_by_run_id IS NULL THEN run.status
            WHEN run.superseded_by_run_id = run.run_id THEN 'set_aside' ELSE 'superseded' END AS status,
       coalesce(run.reason, (SELECT blocked_files.message FROM blocked_files
                             WHERE blocked_files.run_id = run.run_id AND run.status = 'streaming')) AS reason,
       coalesce(run.reason_line, (SELECT blocked_file.line FROM blocked_file
                                  WHERE blocked_file.run_id = run.run_id AND run.status = 'streaming')) AS reason_line,
       run.reason_column,
       run.model,
       nullif(run.superseded_by_run_id, run.run_id) AS superseded_by_run_id,
       run.kind,
       run.rows_skipped,
       (SELECT nullif(host_session.host, '') FROM host_session
        WHERE host_session.host_session_id = run.host_session_id) AS host,
       (SELECT blocked_file.blocked_at FROM blocked_file
        WHERE blocked_file.run_id = run.run_id AND run.status = 'streaming') AS blocked_at,
       run.date_problem,
       run.recorded_start_text AS recorded_start_at
FROM run
JOIN robot USING (robot_id);
CREATE VIEW fleet_health AS
WITH latest AS (
    SELECT robot.robot_id, robot.name AS robot, robot.expected_by, robot.overdue, run.run_id, run.started_at,
           run.started_at_text
    FROM robot
    JOIN run ON run.run_id = (
        SELECT newest.run_id FROM run AS newest
        WHERE newest.robot_id = robot.robot_id AND newest.status = 'complete' AND newest.kind = 'test'
        ORDER BY newest.started_at DESC, newest.run_id DESC
        LIMIT 1
    )
),
-- the newest export that was not understood, where no test is as new
faulty AS (
    SELECT latest.robot_id, run.source_name, run.reason
    FROM latest
    JOIN run ON run.run_id = (
        SELECT newest.run_id FROM run AS newest
        WHERE newest.robot_id = latest.robot_id AND newest.status = 'quarantined' AND newest.kind = 'test'
              AND newest.superseded_by_run_id IS NULL AND newest.started_at > latest.started_at
        ORDER BY newest.started_at DESC, newest.run_id DESC
        LIMIT 1
    )
),
-- a growing export of which nothing can be read behind a line
blocked AS (
    SELECT latest.robot_id, blocked_files.source_name, blocked_files.message
    FROM latest
    JOIN blocked_files ON blocked_files.robot = latest.robot
    WHERE NOT EXISTS (SELECT 1 FROM blocked_file AS later
                      WHERE later.robot = latest.robot AND later.path > blocked_files.source_path)
),
-- the tests that arrived last, where their dates cannot be right
misdated AS (
    SELECT latest.robot_id, run.source_name, run.date_problem
    FROM latest
    JOIN run ON run.run_id = (
        SELECT max(own.run_id) FROM run AS own WHERE own.robot_id = latest.robot_id AND own.set_aside = 'implausible_date'
    )
    WHERE run.kind = 'test' AND NOT EXISTS (
        SELECT 1 FROM run AS later
        WHERE later.robot_id = latest.robot_id AND later.status = 'complete' AND later.kind = 'test'
              AND later.run_id > run.run_id
    )
),
member AS (
    SELECT latest.robot_id, run_joint_summary.joint FROM latest JOIN run_joint_summary USING (run_id)
    UNION
    SELECT latest.robot_id, joint_health.joint FROM latest JOIN joint_health USING (robot_id)
),
-- anomalies of the whole arm are every joint's
trouble AS (
    SELECT member.robot_id, member.joint,
           count(CASE WHEN anomaly.state = 'open' THEN 1 END) AS open_anomalies,
           max(CASE WHEN anomaly.severity = 'critical' THEN 1 ELSE 0 END) AS critical,
           max(CASE WHEN anomaly.severity = 'warning' THEN 1 ELSE 0 END) AS warning
    FROM member
    JOIN anomaly ON anomaly.robot_id = member.robot_id AND ifnull(anomaly.joint, member.joint) = member.joint
    WHERE anomaly.state NOT IN ('resolved', 'false_alarm') AND NOT anomaly.withdrawn
    GROUP BY member.robot_id, member.joint
),
judged AS (
    SELECT latest.robot_id,
           latest.robot,
           latest.run_id,
           latest.started_at_text,
           latest.expected_by,
           member.joint,
           joint_health.friction_index,
           joint_health.friction_quantity,
           joint_health.reason,
           joint_health.last_result_run_id,
           joint_health.trend,
           joint_health.warning_by,
           joint_health.warning_by_lower,
           joint_health.warning_by_upper,
           joint_health.critical_by,
           joint_health.critical_by_lower,
           joint_health.critical_by_upper,
           ifnull(trouble.open_anomalies, 0) AS open_anomalies,
           faulty.source_name AS faulty_name,
           faulty.reason AS faulty_reason,
           conclusion_fault.reason AS not_concluded,
           blocked.source_name AS blocked_name,
           blocked.message AS blocked_message,
           misdated.source_name AS misdated_name,
           misdated.date_problem,
           CASE
               WHEN faulty.robot_id IS NOT NULL OR conclusion_fault.robot_id IS NOT NULL
                    OR joint_health.knowledge = 'no_result' THEN 'unknown'
               WHEN trouble.critical = 1 THEN 'critical'
               WHEN trouble.warning = 1 THEN 'warning'
               WHEN blocked.robot_id IS NOT NULL OR misdated.robot_id IS NOT NULL
                    OR joint_health.knowledge = 'unsettled' THEN 'unknown'
               WHEN latest.overdue = 1 THEN 'overdue'
               WHEN ifnull(joint_health.knowledge, 'learning') = 'learning' THEN 'learning'
               ELSE 'ok'
           END AS status
    FROM member
    JOIN latest ON latest.robot_id = member.robot_id
    LEFT JOIN faulty ON faulty.robot_id = member.robot_id
    LEFT JOIN conclusion_fault ON conclusion_fault.robot_id = member.robot_id
    LEFT JOIN blocked ON blocked.robot_id = member.robot_id
    LEFT JOIN misdated ON misdated.robot_id = member.robot_id
    LEFT JOIN joint_health ON joint_health.robot_id = member.robot_id AND joint_health.joint = member.joint
    LEFT JOIN trouble ON trouble.robot_id = member.robot_id AND trouble.joint = member.joint
)
SELECT judged.robot,
       judged.joint,
       judged.started_at_text AS last_run_at,
       run_joint_summary.relative_rmsd AS moving_relative_rmsd,
       judged.friction_index,
       judged.open_anomalies,
       judged.status,
       result.started_at_text AS last_result_at,
       CASE
           WHEN judged.faulty_name IS NOT NULL
               THEN 'the latest export, ' || judged.faulty_name || ', is in quarantine: ' || judged.faulty_reason
           WHEN judged.not_concluded IS NOT NULL
               THEN 'nothing is concluded of the latest tests: ' || judged.not_concluded
           WHEN judged.status = 'unknown' AND judged.blocked_name IS NOT NULL
               THEN judged.blocked_name || ' ' || judged.blocked_message
           WHEN judged.status = 'unknown' AND judged.misdated_name IS NOT NULL
               THEN 'the date of the latest test, ' || judged.misdated_name || ', cannot be right: it is '
                    || judged.date_problem || '; judged by the tests until ' || judged.started_at_text
           WHEN judged.status IN ('critical', 'warning') OR judged.status = 'ok' AND judged.reason IS NULL THEN (
               SELECT anomaly.message FROM anomaly
               WHERE anomaly.robot_id = judged.robot_id AND ifnull(anomaly.joint, judged.joint) = judged.joint
                     AND anomaly.state NOT IN ('resolved', 'false_alarm') AND NOT anomaly.withdrawn
               ORDER BY anomaly.severity = 'critical' DESC, anomaly.severity = 'warning' DESC,
                        anomaly.last_seen_at DESC, anomaly.anomaly_id DESC
               LIMIT 1
           )
           WHEN judged.status = 'overdue'
               THEN 'no test since that of ' || judged.started_at_text
                    || '; the next was expected by ' || judged.expected_by
           ELSE judged.reason
       END AS reason,
       judged.expected_by,
       judged.friction_quantity,
       judged.trend,
       judged.warning_by,
       judged.warning_by_lower,
       judged.warning_by_upper,
       judged.critical_by,
       judged.critical_by_lower,
       judged.critical_by_upper
FROM judged
LEFT JOIN run_joint_summary
       ON run_joint_summary.run_id = judged.run_id AND run_joint_summary.joint = judged.joint
LEFT JOIN run AS result ON result.run_id = judged.last_result_run_id;
INSERT INTO database_identity (only_one, identity) VALUES (1, lower(hex(randomblob(6))));
INSERT INTO sqlite_sequence (name, seq) VALUES ('anomaly', 0);
INSERT INTO sqlite_sequence (name, seq) VALUES ('anomaly_event', 0);
