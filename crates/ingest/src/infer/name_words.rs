//! Words in the names of columns, from people and vendors, in lower case, separated by blanks: English, German, French,
//! Italian, Spanish, Chinese.

use super::names::ColumnKind;

/// Words for the quantity of a column. The first group with a word in a name decides, so groups with a narrower meaning
/// come first.
pub(super) const KINDS: &[(ColumnKind, &str)] = &[
    (
        ColumnKind::Other("of the tool and not of a joint"),
        "tcp tool eef ee flange cartesian cart pose wrench werkzeug flansch outil utensile herramienta 工具 末端",
    ),
    (
        ColumnKind::Other("an acceleration, which is derived from velocity"),
        "acc accel acceleration qdd ddq beschleunigung accélération accelerazione aceleración 加速度",
    ),
    (ColumnKind::Temperature, "temp tmp temperature temperatur température temperatura 温度 室温 温升"),
    (
        ColumnKind::Torque,
        "trq torque tau drehmoment moment couple coppia par momento effort mtrq tq torq 力矩 扭矩 转矩 eff torques \
        efforts tauj jtq",
    ),
    (
        ColumnKind::Current,
        "current strom cur curr courant corrente corriente amps iq isq 电流 currents amperage intensité corrientes",
    ),
    (
        ColumnKind::Velocity,
        "vel velocity speed qd dq qdot geschwindigkeit geschw drehzahl vitesse velocità velocita velocidad \
        omega mvel spd 速度 转速 velocities vels speeds",
    ),
    (ColumnKind::Stage, "stage phase etappe étape etape fase etapa abschnitt 阶段"),
    (ColumnKind::Cycle, "cycle cycles zyklus zyklen ciclo wiederholung iteration 循环 周期"),
    (ColumnKind::FrictionLevel, "level stufe niveau livello nivel 等级 级别"),
    (
        ColumnKind::Position,
        "pos position posn q angle winkel angolo ángulo angulo posizione posición posicion lage lageist theta \
        mpos istwert ist ang encoder 位置 角度 关节角 positions angles jointpos",
    ),
    (
        ColumnKind::Time,
        "time t zeit timestamp temps tempo tiempo zeitstempel ts clock ticks tick uhrzeit datum date 时间 时间戳 \
        timestamps",
    ),
    (ColumnKind::FrictionJoint, "joint axis achse gelenk axe asse eje articulation 关节 轴 joints achs"),
];

/// Words for a value that no sensor measured: it was commanded, calculated or permitted, or is a part of a measured
/// value.
pub(super) const INTENT: &str = "soll sollwert set target cmd command commanded commands desired ref reference setpoint setpoints \
    consigne des 目标 指令 error err fehler abweichung schleppfehler schleppabstand lag setp sp goal demand demanded requested wanted planned \
    plan plans trajectory traj interpolated predicted prediction pred expected ideal theoretical model \
    modelled modeled computed comp calculated calc calculation estimated estimate estimates est hat \
    observer observed simulated dis sim feedforward ff forward precontrol gravity grav coriolis centrifugal \
    inertia inertial friction fric external ext disturbance collision contact residual resid residue max \
    maximum maximal min minimum minimal limit limits lim threshold tolerance nominal nom rated peak \
    offset bias inverse dynamics vorgabe führung ziel führungsgröße modell modelle berechnet berechnete \
    errechnet geschätzt geschätzte schätz schätzwert schätzung beobachter vorsteuerung vorsteuer \
    schwerkraft gravitation gewichtskraft gewicht reibung reib reibungs reibwert extern externe externes \
    störung stör störgröße stoer grenz grenze grenzwert maximalwert minimalwert nenn nennwert geplant \
    geplante planung vorhersage vorhergesagt prädiziert restfehler residuum trägheit traegheit \
    geschaetzt gewünscht desiderato desiderata desiderate comandato comandata comando riferimento rif \
    modello calcolato calcolata stimato stimata stima gravità gravita attrito esterno esterna limite \
    massimo massima minimo minima nominale pianificato pianificata previsto prevista predetto residuo \
    disturbo obiettivo soglia cible référence commande commandé désiré désirée modèle calculé calculée \
    estimé estimée gravité frottement perturbation prédit prévu résidu consigna objetivo deseado deseada \
    referencia modelo calculado calculada estimado estimada gravedad fricción friccion externo máximo \
    mínimo límite nominales perturbación 期望 设定 给定 参考 估计 计算 模型 前馈 重力 摩擦 外部 外力 限制 最大 最小 额定 误差 预测 扰动";

/// Words for a current that also say that a value is the present one.
pub(super) const PRESENT: &str = "current cur curr courant corrente corriente";

/// Words for a measured value.
pub(super) const MEASURED: &str = "actual act measured meas measurement measure fb fbk feedback ist istwert istwerte gemessen gemessene \
    messwert mess sensor sensors sensed real misurato misurata misura effettivo effettiva attuale reale \
    sensore retroazione mesuré mesurée mesure réel réelle capteur medido medida actuales 实际 测量 反馈 传感";

/// Words for the motor side of the gears.
pub(super) const MOTOR: &str = "motor mot mpos mtrq mvel moteur motore 电机";

/// Parts of words for a temperature, for languages that write words together.
pub(super) const TEMPERATURES: &[&str] = &["temperatur", "températur"];

/// Words for the ambient air.
pub(super) const HALL: &str = "ambient amb room hall environment umgebung umgebungstemperatur raum raumtemperatur halle \
    hallentemperatur ambiante salle ambiente sala nave 环境 室温 室内";

/// Words for parts with a temperature other than motors and gearboxes.
pub(super) const ELECTRONICS: &str = "drive inverter amplifier controller cabinet cpu board encoder umrichter regler verstärker \
    schaltschrank variateur armoire 驱动器 控制柜";

/// Units of columns in many spellings, with their notation in layouts.
pub(super) const UNITS: &[(&str, &[&str])] = &[
    ("rad/s", &["rad/s", "rads", "rad/sec", "rad_s"]),
    ("deg/s", &["deg/s", "°/s", "grad/s", "deg/sec", "deg_s", "度/秒"]),
    ("rpm", &["rpm", "u/min", "1/min", "min-1", "tr/min", "giri/min", "rev/min", "r/min", "转/分"]),
    ("rev/s", &["rev/s", "u/s"]),
    ("m/s", &["m/s"]),
    ("rad", &["rad"]),
    ("deg", &["deg", "°", "grad", "degree", "degrees", "gradi", "grados", "degrés", "度"]),
    ("rev", &["rev", "turns", "umdr", "u"]),
    ("Nm", &["nm", "n.m", "n·m", "n*m", "n m", "newtonmeter"]),
    ("N", &["n"]),
    ("mA", &["ma"]),
    ("A", &["a", "amp", "ampere", "arms"]),
    ("%", &["%", "percent", "prozent", "pct"]),
    ("permille", &["permille", "‰", "promille"]),
    ("min", &["min", "minutes", "minuten", "minuti"]),
    ("h", &["h", "hours", "stunden", "ore"]),
    ("d", &["d", "days", "tage", "giorni"]),
    ("us", &["us", "µs", "μs"]),
    ("ns", &["ns"]),
    ("ms", &["ms", "msec", "毫秒"]),
    ("s", &["s", "sec", "sek", "seconds", "sekunden", "秒"]),
    ("m", &["m"]),
    ("degC", &["°c", "degc", "deg c", "celsius", "grad c", "℃", "c", "摄氏度"]),
    ("degF", &["°f", "degf", "deg f", "fahrenheit", "℉", "f"]),
    ("K", &["k", "kelvin"]),
];
