//! Stored factors against the rows of the export that they came from.

use std::path::{Path, PathBuf};

use tokio_util::sync::CancellationToken;

use super::context::{Outcome, Pipeline, Retry};
use super::stored::chosen_cycles::{
    ParameterCandidate, RunCycles, cross_verification, rmsd_on, unit_identification,
};
use armwatch_config::Config;
use armwatch_ingest::bytes::source::open_hashing;
use armwatch_ingest::table::reader::{ExportReader, ReadOptions};
use armwatch_method::analyse::Method;
use armwatch_method::segment::cycles::CycleCutter;
use armwatch_model::analysis::Estimator;
use armwatch_model::run::Cycle;
use armwatch_simulate::{SimulationSettings, simulate_run};
use armwatch_store::{ParameterSet, Store};
use armwatch_testing::direct::{Direct, assert_equal, raw_parameters};

struct Ingested {
    _folder: tempfile::TempDir,
    store: Store,
    method: Method,
    cycles: Vec<Cycle>,
}

async fn ingested(export: &Path, folder: tempfile::TempDir) -> Ingested {
    let config = Config::shipped().expect("shipped settings");
    let store = Store::open(&folder.path().join("fleet.db")).await.expect("a store");
    let entry = config.fleet.first().expect("a robot");
    let method = Method::new((*entry.description).clone(), config.analysis).expect("base parameters");
    let cycles = cycles_of(export, &method, entry);
    let pipeline = Pipeline::new(std::sync::Arc::new(config), store.clone());
    let stop = CancellationToken::new();
    let outcome = pipeline.process(export, Retry::Never, &stop, |_| ()).await.expect("an outcome");
    assert!(matches!(outcome, Outcome::Stored(_)), "{outcome:?}");
    Ingested { _folder: folder, store, method, cycles }
}

fn cycles_of(export: &Path, method: &Method, entry: &armwatch_config::FleetEntry) -> Vec<Cycle> {
    let (bytes, _) = open_hashing(export).expect("an export");
    let reader = ExportReader::new(bytes, export, &entry.layout, &method.robot, ReadOptions::default());
    let mut cutter = CycleCutter::new();
    let mut cycles = Vec::new();
    for chunk in reader.expect("a header") {
        cutter.push(chunk.expect("rows").samples.as_recorded());
        cycles.extend(std::iter::from_fn(|| cutter.next_cycle().expect("no fault")));
    }
    cycles.extend(cutter.finish().expect("a last cycle"));
    cycles
}

impl Ingested {
    async fn unit(&self, cycles: &[u32], estimator: Estimator) -> ParameterSet {
        let chosen = RunCycles { cycles: Some(cycles.to_vec()), ..RunCycles::all(1) };
        unit_identification(&self.store, &[chosen], estimator).await.expect("parameters")
    }

    fn theta(&self, set: &ParameterSet) -> Vec<f64> {
        let value = |id| set.identification.parameters.iter().find(|p| p.id == id).expect("kept").value;
        self.method.base.kept.iter().map(|id| value(*id)).collect()
    }

    /// Parameters from the factors of two cycles, and their deviation on a third one, are those of
    /// the rows.
    async fn assert_like_the_rows(&self) {
        let set = self.unit(&[1, 2], Estimator::Ordinary).await;
        let theta = self.theta(&set);
        assert_equal(&theta, &raw_parameters(&self.method, &[&self.cycles[0], &self.cycles[1]]));
        let candidate = ParameterCandidate { model: set.model, parameters: set.identification.parameters };
        let third = [RunCycles { cycles: Some(vec![3]), ..RunCycles::all(1) }];
        let rmsd = rmsd_on(&self.store, &candidate, &third).await.expect("deviations");
        let direct = Direct::new(&self.method, &self.cycles[2], &theta);
        direct.assert_verification(&rmsd);
        let cross =
            cross_verification(&self.store, vec![candidate], &[RunCycles::all(1)]).await.expect("deviations");
        assert_eq!(cross[0].by_cycle[2], (3, rmsd));
    }
}

#[tokio::test]
async fn the_reference_export_needs_no_second_reading() {
    let export = PathBuf::from(env!("CARGO_MANIFEST_DIR"))
        .join("tests/reference/R00_20260105_0847_Col23_20s_cycle5.csv.gz");
    let folder = tempfile::tempdir().expect("a folder");
    ingested(&export, folder).await.assert_like_the_rows().await;
}

#[tokio::test]
async fn a_simulated_export_needs_no_second_reading() {
    let folder = tempfile::tempdir().expect("a folder");
    let first_start = "2026-01-05T08:47:00Z".parse().expect("a time");
    let settings =
        SimulationSettings { cycles: 3, warming_s: 5.0, first_start, ..SimulationSettings::default() };
    let robot = armwatch_testing::er3a();
    let files = simulate_run(&robot, &settings, 0, folder.path(), &mut |_| ()).expect("an export");
    let ingested = ingested(&files.export, folder).await;
    ingested.assert_like_the_rows().await;

    let one = ingested.unit(&[2], Estimator::Weighted).await;
    let mut stored = ingested.store.cycle_parameters(1, 2).await.expect("parameters");
    stored.sort_by_key(|parameter| parameter.id);
    let values = |of: &[armwatch_model::analysis::IdentifiedParameter]| -> (Vec<f64>, Vec<f64>) {
        of.iter().map(|p| (p.value, p.std_error)).unzip()
    };
    let (found, expected) = (values(&one.identification.parameters), values(&stored));
    assert_equal(&found.0, &expected.0);
    // the shares bring the sum of all joints' variances to that of the blocks, not each parameter's
    let logs: Vec<f64> = found.1.iter().zip(&expected.1).map(|(a, b)| (a / b).ln()).collect();
    let mean = logs.iter().sum::<f64>() / logs.len() as f64;
    assert!(mean.abs() < 0.2 && logs.iter().all(|log| log.abs() < 1.0), "{logs:?}");
}

#[tokio::test]
async fn what_is_not_there_is_named() {
    let folder = tempfile::tempdir().expect("a folder");
    let store = Store::open(&folder.path().join("fleet.db")).await.expect("a store");
    let chosen = RunCycles::all(7);
    let error = unit_identification(&store, &[chosen], Estimator::Weighted).await.expect_err("no run");
    assert!(error.to_string().contains("there is no run 7, and no run has cycles"), "{error}");
    let error = unit_identification(&store, &[], Estimator::Weighted).await.expect_err("nothing");
    assert!(error.to_string().contains("no cycles"), "{error}");
}
