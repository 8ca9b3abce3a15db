-- Results of runs: what was recorded, what was computed from it, what is concluded.
--
-- Tables are the program's own affair; people and scripts read the views at the end, whose names and
-- columns only change with a migration. Conventions:
--   * Times are integer microseconds since 1970 UTC: exact, small, sortable. Views show RFC 3339.
--   * Units are SI and end the name. Joints count from 1.
--   * A figure that is not finite is NULL: JSON and most tools cannot carry NaN or infinity.
--   * WITHOUT ROWID where the key is the natural access path: one tree instead of table and index.

-- "Aw" "db": tells this file from any other program's database.
PRAGMA application_id = 0x41776462;

CREATE TABLE robot (
    robot_id INTEGER PRIMARY KEY,
    name     TEXT NOT NULL UNIQUE
) STRICT;

-- A described arm. Geometry and gravity decide what a base parameter stands for, so a changed
-- description is another row and old results keep their meaning.
CREATE TABLE robot_model (
    robot_model_id   INTEGER PRIMARY KEY,
    name             TEXT NOT NULL,
    -- BLAKE3 of joint kinds, modified Denavit-Hartenberg parameters and gravity.
    description_hash BLOB NOT NULL CHECK (length(description_hash) = 32),
    UNIQUE (name, description_hash)
) STRICT;

-- A parameter of a model. Unit and grouping stand here once instead of in every cycle.
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

-- The ledger: one row an export, whatever became of it.
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
    ingested_at    INTEGER NOT NULL DEFAULT (CAST(unixepoch('subsec') * 1000000 AS INTEGER)),
    CHECK ((status = 'quarantined') = (reason IS NOT NULL)),
    CHECK (status <> 'complete' OR (rows IS NOT NULL AND cycles_total = cycles_stored))
) STRICT;

-- History of a robot in order, and its latest complete run, without sorting.
CREATE INDEX run_by_robot ON run (robot_id, status, started_at, run_id);

-- Files as they were last seen, so that a program that starts again need not read every export to
-- know it. Only a hint: a file of another size or time is read, and its content decides.
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
    residual_std_nm         REAL,
    UNIQUE (run_id, number),
    CHECK ((status = 'refused') = (reason IS NOT NULL))
) STRICT;

CREATE TABLE cycle_parameter (
    cycle_id           INTEGER NOT NULL REFERENCES cycle ON DELETE CASCADE,
    model_parameter_id INTEGER NOT NULL REFERENCES model_parameter,
    value              REAL NOT NULL,
    std_error          REAL,
    PRIMARY KEY (cycle_id, model_parameter_id)
) STRICT, WITHOUT ROWID;

-- Root-mean-square deviation between the estimated torque and the measured torque after the
-- analysis low-pass (cycle.cutoff_hz) [5.1]. relative_rmsd divides by the RMS of that measured
-- torque over the same rows. moving_* leaves out rows in which the joint hardly moves, where the
-- friction model is wrong; NULL if it never moves.
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
    moving_samples       INTEGER NOT NULL CHECK (moving_samples >= 0),
    CHECK ((verification = 'cross') = (reference_run_id IS NOT NULL))
) STRICT;

-- ifnull, because a unique index takes every NULL for another value. This order, because a history
-- asks for one joint and stage of many cycles.
CREATE UNIQUE INDEX torque_rmsd_key ON torque_rmsd (cycle_id, stage, joint, ifnull(reference_run_id, 0));
-- Deleting a run looks for what refers to it; hardly any row does.
CREATE INDEX torque_rmsd_by_reference ON torque_rmsd (reference_run_id) WHERE reference_run_id IS NOT NULL;

-- Mean friction on one constant-speed plateau. Warm-up fits ask for one speed of many cycles, so
-- speed comes early in the key; number is the place in the cycle's list, since a level may be
-- passed more than once.
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

-- Friction over time [5.4]: a + b exp(-t/t1) + c exp(-t/t2), t1 > t2. Without run_id the fit is over
-- all complete runs of the robot.
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
    samples          INTEGER NOT NULL CHECK (samples >= 0),
    CHECK ((model = 'constant') = (b_nm IS NULL)),
    CHECK ((model = 'double') = (c_nm IS NOT NULL)),
    CHECK ((b_nm IS NULL) = (t1_min IS NULL) AND (c_nm IS NULL) = (t2_min IS NULL)),
    CHECK (t2_min IS NULL OR t1_min > t2_min)
) STRICT;

CREATE UNIQUE INDEX warmup_fit_key ON warmup_fit (robot_id, ifnull(run_id, 0), joint, speed_fraction);
CREATE INDEX warmup_fit_by_run ON warmup_fit (run_id) WHERE run_id IS NOT NULL;

-- Statistics of a parameter over the cycles of a run. Stored, since a dashboard compares many runs.
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

-- What a run says of a joint, condensed for the detectors, which read whole histories.
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
    rmsd_swing_cycles          INTEGER,
    PRIMARY KEY (run_id, joint)
) STRICT, WITHOUT ROWID;

-- The same history always gives the same anomalies; the unique key recognises each, so that it keeps
-- its number and a person's acknowledgement.
CREATE TABLE anomaly (
    -- AUTOINCREMENT: readers ask for "newer than this number".
    anomaly_id    INTEGER PRIMARY KEY AUTOINCREMENT,
    robot_id      INTEGER NOT NULL REFERENCES robot ON DELETE CASCADE,
    joint         INTEGER NOT NULL CHECK (joint >= 1),
    kind          TEXT NOT NULL CHECK (kind IN (
                      'drift', 'oscillation', 'step', 'thermal', 'payload', 'sensor', 'accuracy', 'fleet')),
    quantity      TEXT NOT NULL,
    severity      TEXT NOT NULL CHECK (severity IN ('info', 'warning', 'critical')),
    score         REAL,
    threshold     REAL,
    value         REAL,
    baseline      REAL,
    first_run_id  INTEGER NOT NULL REFERENCES run ON DELETE CASCADE,
    last_run_id   INTEGER REFERENCES run ON DELETE SET NULL,
    first_seen_at INTEGER NOT NULL,
    last_seen_at  INTEGER NOT NULL,
    state         TEXT NOT NULL CHECK (state IN ('open', 'acknowledged', 'resolved')),
    message       TEXT NOT NULL,
    UNIQUE (robot_id, joint, kind, quantity, first_run_id)
) STRICT;

CREATE INDEX anomaly_by_first_run ON anomaly (first_run_id);
CREATE INDEX anomaly_by_last_run ON anomaly (last_run_id);

-- Where the joint stands after the robot's latest finished run.
CREATE TABLE joint_health (
    robot_id       INTEGER NOT NULL REFERENCES robot ON DELETE CASCADE,
    joint          INTEGER NOT NULL CHECK (joint >= 1),
    friction_index REAL,
    learning       INTEGER NOT NULL CHECK (learning IN (0, 1)),
    PRIMARY KEY (robot_id, joint)
) STRICT, WITHOUT ROWID;

-- The contract -------------------------------------------------------------------------------------
-- Times show milliseconds unless these are zero; the replace() keeps whole seconds short.

CREATE VIEW runs AS
SELECT run.run_id,
       robot.name AS robot,
       replace(strftime('%Y-%m-%dT%H:%M:%fZ', run.started_at / 1000000.0, 'unixepoch'), '.000Z', 'Z') AS started_at,
       run.source_name,
       lower(hex(run.content_hash)) AS content_hash,
       run.rows,
       run.sample_rate_hz,
       run.cycles_stored AS cycles,
       run.status,
       run.reason,
       run.reason_line,
       run.reason_column,
       run.model
FROM run
JOIN robot USING (robot_id);

CREATE VIEW cycles AS
SELECT cycle.run_id,
       robot.name AS robot,
       cycle.number AS cycle,
       replace(strftime('%Y-%m-%dT%H:%M:%fZ', cycle.started_at / 1000000.0, 'unixepoch'), '.000Z', 'Z') AS started_at,
       cycle.duration_s,
       cycle.rows,
       cycle.status,
       cycle.reason,
       cycle.remarks,
       cycle.sample_rate_hz,
       cycle.cutoff_hz,
       cycle.samples,
       cycle.condition_number,
       cycle.scaled_condition_number,
       cycle.residual_std_nm
FROM cycle
JOIN run USING (run_id)
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
       model_parameter.grouping
FROM cycle_parameter
JOIN model_parameter USING (model_parameter_id)
JOIN cycle USING (cycle_id)
JOIN run USING (run_id)
JOIN robot USING (robot_id);

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
       torque_rmsd.moving_samples
FROM torque_rmsd
JOIN cycle USING (cycle_id)
JOIN run USING (run_id)
JOIN robot USING (robot_id);

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
       warmup_fit.samples
FROM warmup_fit
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

-- run_id is the run with which the episode began, last_run_id the latest that showed it. No kind of
-- anomaly found so far points at a cycle.
CREATE VIEW anomalies AS
SELECT anomaly.anomaly_id,
       robot.name AS robot,
       anomaly.first_run_id AS run_id,
       CAST(NULL AS INTEGER) AS cycle,
       anomaly.joint,
       anomaly.kind,
       anomaly.quantity,
       anomaly.severity,
       anomaly.score,
       anomaly.threshold,
       anomaly.value,
       anomaly.baseline,
       replace(strftime('%Y-%m-%dT%H:%M:%fZ', anomaly.first_seen_at / 1000000.0, 'unixepoch'), '.000Z', 'Z')
           AS first_seen_at,
       replace(strftime('%Y-%m-%dT%H:%M:%fZ', anomaly.last_seen_at / 1000000.0, 'unixepoch'), '.000Z', 'Z')
           AS last_seen_at,
       anomaly.state,
       anomaly.message,
       anomaly.last_run_id
FROM anomaly
JOIN robot USING (robot_id);

-- One row a robot and joint. An acknowledged anomaly still colours the status: it is known, not gone.
-- open_anomalies counts the state 'open' alone, as the view anomalies does.
CREATE VIEW fleet_health AS
WITH latest AS (
    SELECT robot.robot_id, robot.name AS robot, run.run_id, run.started_at
    FROM robot
    JOIN run ON run.run_id = (
        SELECT newest.run_id FROM run AS newest
        WHERE newest.robot_id = robot.robot_id AND newest.status = 'complete'
        ORDER BY newest.started_at DESC, newest.run_id DESC
        LIMIT 1
    )
),
member AS (
    SELECT latest.robot_id, run_joint_summary.joint FROM latest JOIN run_joint_summary USING (run_id)
    UNION
    SELECT latest.robot_id, joint_health.joint FROM latest JOIN joint_health USING (robot_id)
),
trouble AS (
    SELECT robot_id, joint,
           sum(state = 'open') AS open_anomalies,
           max(severity = 'critical') AS critical,
           max(severity = 'warning') AS warning
    FROM anomaly
    WHERE state <> 'resolved'
    GROUP BY robot_id, joint
)
SELECT latest.robot,
       member.joint,
       replace(strftime('%Y-%m-%dT%H:%M:%fZ', latest.started_at / 1000000.0, 'unixepoch'), '.000Z', 'Z') AS last_run_at,
       run_joint_summary.relative_rmsd AS moving_relative_rmsd,
       joint_health.friction_index,
       ifnull(trouble.open_anomalies, 0) AS open_anomalies,
       CASE
           WHEN trouble.critical THEN 'critical'
           WHEN trouble.warning THEN 'warning'
           WHEN ifnull(joint_health.learning, 1) THEN 'learning'
           ELSE 'ok'
       END AS status
FROM member
JOIN latest ON latest.robot_id = member.robot_id
LEFT JOIN run_joint_summary ON run_joint_summary.run_id = latest.run_id AND run_joint_summary.joint = member.joint
LEFT JOIN joint_health ON joint_health.robot_id = member.robot_id AND joint_health.joint = member.joint
LEFT JOIN trouble ON trouble.robot_id = member.robot_id AND trouble.joint = member.joint;
