//! Single series with the program's sequential chart: its rate of alarms without a shift, and its delay with one.
//!
//! A series is an autoregression of order one of normal noise, or of Student's with four degrees of freedom. The chart
//! learns from its first values, with a prior whose scale is wrong by a factor of two, and then runs for a year. A
//! shift moves the noise, so that its size is in standard deviations of whitened values. Before a shift, the statistic
//! is at zero: Lorden's bound applies to this worst case.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};

use super::draws::Draws;
use armwatch_method::detect::control_chart::EWMA_WEIGHT;
use armwatch_method::detect::rate::average;
use armwatch_method::detect::rate::budget::Budget;
use armwatch_method::detect::rate::chart::lorden_delay;
use armwatch_method::detect::rate::monitor::{Monitor, OWN_FROM};
use armwatch_method::detect::rate::whitening::Prior;

/// Values per year: daily tests of eight cycles.
pub const VALUES_PER_YEAR: usize = 365 * 8;
/// Requested rates per year.
pub const RATES: [f64; 4] = [0.2, 1.0, 5.0, 20.0];
/// Autocorrelations of the series.
pub const CORRELATIONS: [f64; 4] = [0.0, 0.3, 0.6, 0.9];
/// Degrees of freedom of the noise; `None`: normal.
pub const FREEDOMS: [Option<f64>; 2] = [None, Some(4.0)];
/// Numbers of values that a series is learnt from: enough for its own limit, forty tests, and enough for the promised
/// realised rates.
pub const LEARNT: [usize; 3] = [OWN_FROM, 320, 1000];
/// Numbers of values that a series is learnt from before it shifts: forty tests, and enough for the promised realised
/// rates.
pub const LEARNT_BEFORE_SHIFTS: [usize; 2] = [320, 1000];
/// Shifts, in standard deviations of a whitened value.
pub const SHIFTS: [f64; 3] = [1.0, 2.0, 3.0];
/// Values per year for the measurement of delays: daily tests of eight cycles, and sixty values per day.
pub const VALUES_OF_DELAYS: [f64; 2] = [VALUES_PER_YEAR as f64, 365.0 * 60.0];
/// Joints of the robot whose channels share one false alarm per year.
pub const JOINTS: usize = 6;

/// Scale of the prior; the scale of the noise is one.
const PRIOR_SCALE: f64 = 2.0;
/// Years per piece of work, so that all threads have some.
const YEARS_AT_ONCE: usize = 20;
/// Longest measured delay, values.
const MOST_DELAY: usize = 2000;

/// False alarms of one kind of series.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RealisedRate {
    /// Degrees of freedom of the noise; `None`: normal.
    pub freedom: Option<f64>,
    /// Autocorrelation.
    pub correlation: f64,
    /// Values learnt from.
    pub learnt: usize,
    /// Requested rate per year.
    pub asked: f64,
    /// Number of alarms.
    pub alarms: usize,
    /// Number of years.
    pub years: usize,
}

/// Delay of one kind of series.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Delay {
    /// Degrees of freedom of the noise; `None`: normal.
    pub freedom: Option<f64>,
    /// Autocorrelation.
    pub correlation: f64,
    /// Values learnt from.
    pub learnt: usize,
    /// Channels that share one false alarm per year: one, or all of a robot.
    pub channels: usize,
    /// Mean number of values between false alarms of this channel.
    pub run_length: f64,
    /// Size of the shift, standard deviations.
    pub shift: f64,
    /// Mean number of values until the alarm, including the first with the shift.
    pub mean: f64,
    /// Its standard error.
    pub std_error: f64,
    /// Lorden's bound.
    pub bound: f64,
}

/// Settings of the measurement.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RateSettings {
    /// Series of each kind; each runs for a year.
    pub series: usize,
    /// Seed of all random values.
    pub seed: u64,
    /// Threads.
    pub threads: usize,
}

/// Realised rates of all kinds of series. The same settings give the same results for any number of threads.
pub fn realised_rates(settings: &RateSettings, on_piece: &(dyn Fn() + Sync)) -> Vec<RealisedRate> {
    let mut kinds = Vec::new();
    for freedom in FREEDOMS {
        for correlation in CORRELATIONS {
            for learnt in LEARNT {
                for asked in RATES {
                    let years = settings.series;
                    kinds.push(RealisedRate { freedom, correlation, learnt, asked, alarms: 0, years });
                }
            }
        }
    }
    let pieces: Vec<(usize, usize)> = (0..kinds.len())
        .flat_map(|kind| (0..settings.series.div_ceil(YEARS_AT_ONCE)).map(move |piece| (kind, piece)))
        .collect();
    let counted = on_all_cores(settings.threads, pieces.len(), on_piece, |number| {
        let (kind, piece) = pieces[number];
        let first = piece * YEARS_AT_ONCE;
        let of = |series: usize| alarms(&kinds[kind], &mut Draws::new(settings.seed, stream(kind, series)));
        (first..settings.series.min(first + YEARS_AT_ONCE)).map(of).sum::<usize>()
    });
    for ((kind, _), alarms) in pieces.iter().zip(counted) {
        kinds[*kind].alarms += alarms;
    }
    kinds
}

/// Pieces of work of [`realised_rates`].
pub fn rate_pieces(series: usize) -> usize {
    FREEDOMS.len() * CORRELATIONS.len() * LEARNT.len() * RATES.len() * series.div_ceil(YEARS_AT_ONCE)
}

/// Mean delays, from [`RateSettings::series`] series each.
pub fn delays(settings: &RateSettings) -> Vec<Delay> {
    let mut kinds = Vec::new();
    for freedom in FREEDOMS {
        for correlation in [CORRELATIONS[0], CORRELATIONS[2]] {
            for learnt in LEARNT_BEFORE_SHIFTS {
                for (channels, run_length) in run_lengths() {
                    for shift in SHIFTS {
                        let bound = lorden_delay(run_length, shift);
                        let (mean, std_error) = (0.0, 0.0);
                        kinds.push(Delay {
                            freedom,
                            correlation,
                            learnt,
                            channels,
                            run_length,
                            shift,
                            mean,
                            std_error,
                            bound,
                        });
                    }
                }
            }
        }
    }
    let found = on_all_cores(settings.threads, kinds.len(), &|| (), |kind| {
        let of = |series: usize| {
            delay(&kinds[kind], &mut Draws::new(settings.seed, stream(DELAYS + kind, series))) as f64
        };
        let all: Vec<f64> = (0..settings.series).map(of).collect();
        let mean = all.iter().sum::<f64>() / all.len().max(1) as f64;
        let squares: f64 = all.iter().map(|of| (of - mean).powi(2)).sum();
        (mean, squares.sqrt() / all.len().max(1) as f64)
    });
    for (kind, (mean, std_error)) in kinds.iter_mut().zip(found) {
        (kind.mean, kind.std_error) = (mean, std_error);
    }
    kinds
}

/// Numbers of channels that share one false alarm per year, with the mean number of values between two alarms of each.
fn run_lengths() -> Vec<(usize, f64)> {
    let all = Budget::new(1.0, JOINTS, &[]).channels;
    let each = |channels: usize| VALUES_OF_DELAYS.map(|values| (channels, values * channels as f64));
    [1, all].into_iter().flat_map(each).collect()
}

/// Delay of the moving average that monitors the level of friction, by its integral equation: for one of all channels
/// of a robot that is tested daily.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LevelDelay {
    /// Size of the shift, standard deviations of a test about the level.
    pub shift: f64,
    /// Mean number of tests between false alarms.
    pub run_length: f64,
    /// Mean number of tests until the alarm, including the first with the shift.
    pub mean: f64,
    /// Lorden's bound.
    pub bound: f64,
}

/// Delays for the level of friction at one false alarm per year.
pub fn level_delays() -> Vec<LevelDelay> {
    let run_length = Budget::new(1.0, JOINTS, &[]).run_length();
    let half_width = average::limit(EWMA_WEIGHT, run_length) * (EWMA_WEIGHT / (2.0 - EWMA_WEIGHT)).sqrt();
    let of = |shift: f64| LevelDelay {
        shift,
        run_length,
        mean: average::mean_run_length(EWMA_WEIGHT, half_width, shift),
        bound: lorden_delay(run_length, shift),
    };
    [1.0, 2.0, 3.0, 5.0, 8.0].map(of).to_vec()
}

/// Streams of random numbers of delays begin here; rates have the earlier ones.
const DELAYS: usize = 1 << 16;

/// The stream of a series: each series of each kind has its own, so that results are independent.
fn stream(kind: usize, series: usize) -> u64 {
    ((kind as u64) << 32) + series as u64
}

/// An autoregression of order one; its noise has variance one.
struct Autoregression<'a> {
    correlation: f64,
    freedom: Option<f64>,
    state: f64,
    draws: &'a mut Draws,
}

impl<'a> Autoregression<'a> {
    fn new(correlation: f64, freedom: Option<f64>, draws: &'a mut Draws) -> Self {
        let state = draws.noise(freedom) / (1.0 - correlation * correlation).sqrt();
        Self { correlation, freedom, state, draws }
    }

    fn next(&mut self, shift: f64) -> f64 {
        self.state = self.correlation * self.state + self.draws.noise(self.freedom) + shift;
        self.state
    }
}

/// Alarms of one series in a year.
fn alarms(kind: &RealisedRate, draws: &mut Draws) -> usize {
    let mut series = Autoregression::new(kind.correlation, kind.freedom, draws);
    let mut monitor = Monitor::new(Prior::vague(PRIOR_SCALE), VALUES_PER_YEAR as f64 / kind.asked);
    (0..kind.learnt).for_each(|_| _ = monitor.add(series.next(0.0), 0.0));
    monitor.restart();
    (0..VALUES_PER_YEAR).filter(|_| monitor.add(series.next(0.0), 0.0).is_out).count()
}

/// Values until an alarm of one series whose noise shifts after the values that it was learnt from.
fn delay(kind: &Delay, draws: &mut Draws) -> usize {
    let mut series = Autoregression::new(kind.correlation, kind.freedom, draws);
    let mut monitor = Monitor::new(Prior::vague(PRIOR_SCALE), kind.run_length);
    (0..kind.learnt).for_each(|_| _ = monitor.add(series.next(0.0), 0.0));
    monitor.restart();
    1 + (1..MOST_DELAY).take_while(|_| !monitor.add(series.next(kind.shift), 0.0).is_out).count()
}

/// Results of `count` pieces of work in their order.
fn on_all_cores<T: Send>(
    threads: usize,
    count: usize,
    on_piece: &(dyn Fn() + Sync),
    work: impl Fn(usize) -> T + Sync,
) -> Vec<T> {
    let next = AtomicUsize::new(0);
    let done: Mutex<Vec<(usize, T)>> = Mutex::new(Vec::with_capacity(count));
    std::thread::scope(|scope| {
        for _ in 0..threads.max(1) {
            scope.spawn(|| {
                loop {
                    let number = next.fetch_add(1, Ordering::Relaxed);
                    if number >= count {
                        return;
                    }
                    let result = work(number);
                    done.lock().unwrap_or_else(PoisonError::into_inner).push((number, result));
                    on_piece();
                }
            });
        }
    });
    let mut done = done.into_inner().unwrap_or_else(PoisonError::into_inner);
    done.sort_by_key(|(number, _)| *number);
    done.into_iter().map(|(_, result)| result).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn figures_do_not_depend_on_threads_and_delays_shrink_with_the_shift() {
        let settings = |threads| RateSettings { series: 3, seed: 7, threads };
        assert_eq!(realised_rates(&settings(1), &|| ()), realised_rates(&settings(3), &|| ()));
        let found = delays(&settings(2));
        assert!(found.chunks(SHIFTS.len()).all(|of| of[0].mean > of[2].mean), "{found:?}");
        assert_eq!(rate_pieces(40), 192);
    }
}
