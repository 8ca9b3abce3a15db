//! Response of a test's parameters to channels that read wrong.

use std::sync::Arc;

use crate::engine::{Bind, EngineExecutor, Run};
use crate::values::{standard_parameter, unreadable};
use armwatch_model::analysis::response::{ChannelFault, ChannelResponse, FaultResponse, STRENGTHS};
use armwatch_model::robot::{JointIndex, ParameterId};

/// Stores the response of a cycle, replacing that of an earlier cycle of the run.
pub(crate) async fn record(
    executor: impl EngineExecutor<'_>,
    run_id: i64,
    response: &ChannelResponse,
) -> sqlx::Result<()> {
    let parameters: Vec<String> = response.parameters.iter().map(ToString::to_string).collect();
    sqlx::query(
        "INSERT INTO channel_response (run_id, parameters, numbers) VALUES ($1, $2, $3)
         ON CONFLICT (run_id) DO UPDATE SET parameters = excluded.parameters, numbers = excluded.numbers",
    )
    .bind_all((run_id, parameters.join(" "), packed(response)))
    .run(executor)
    .await
}

/// The response of a run; `None` for a run without parameters, or stored before responses existed.
pub(crate) async fn of_run(
    executor: impl EngineExecutor<'_>,
    run_id: i64,
) -> sqlx::Result<Option<Arc<ChannelResponse>>> {
    let row: Option<(String, Vec<u8>)> =
        sqlx::query_as("SELECT parameters, numbers FROM channel_response WHERE run_id = $1")
            .bind(run_id)
            .fetch_optional(executor)
            .await?;
    row.map(|(parameters, numbers)| {
        let ids: Option<Vec<ParameterId>> = parameters.split_whitespace().map(standard_parameter).collect();
        ids.and_then(|ids| unpacked(ids, &numbers))
            .map(Arc::new)
            .ok_or_else(|| unreadable("channel_response", run_id))
    })
    .transpose()
}

/// Numbers of four bytes: a response is a model and needs no more digits. Shifts are last, and only if all faults that
/// can have one do: rows of earlier versions have none.
fn packed(response: &ChannelResponse) -> Vec<u8> {
    let numbers = response.faults.iter().flat_map(|of| of.change.iter().chain(&of.unexplained));
    let shifts = || response.faults.iter().filter(|of| may_shift(of));
    let have_all = shifts().all(|of| of.shift.len() == response.parameters.len());
    let numbers = numbers.chain(shifts().filter(|_| have_all).flat_map(|of| &of.shift));
    numbers.flat_map(|number| (*number as f32).to_le_bytes()).collect()
}

/// True if the weights during a fault may themselves move parameters, and this shift is computed.
fn may_shift(of: &FaultResponse) -> bool {
    of.fault == ChannelFault::TorqueOffset && of.strength > 0
}

fn unpacked(parameters: Vec<ParameterId>, bytes: &[u8]) -> Option<ChannelResponse> {
    let (numbers, rest) = bytes.as_chunks::<4>();
    let numbers: Vec<f64> = numbers.iter().map(|of| f64::from(f32::from_le_bytes(*of))).collect();
    let (b, kinds) = (parameters.len(), ChannelFault::ALL.len() * STRENGTHS.len());
    // kinds * n faults of b + n numbers each, and the shifts of b numbers each
    let of_faults = |n: usize| kinds * n * (b + n);
    let of_shifts = |n: usize| (STRENGTHS.len() - 1) * n * b;
    // the last joint has a parameter
    let joints = parameters.iter().map(|of| of.joint.number()).max()?;
    let fits = |n: &usize| [0, of_shifts(*n)].contains(&numbers.len().wrapping_sub(of_faults(*n)));
    let n = std::iter::once(joints).chain(1..=armwatch_model::robot::MAX_JOINTS).find(fits)?;
    let (numbers, shifts) = numbers.split_at(of_faults(n));
    let fault = |(place, numbers): (usize, &[f64])| FaultResponse {
        joint: JointIndex::new(place % n),
        strength: place / n % STRENGTHS.len(),
        fault: ChannelFault::ALL[place / n / STRENGTHS.len()],
        change: numbers[..b].to_vec(),
        shift: Vec::new(),
        unexplained: numbers[b..].to_vec(),
    };
    let mut faults: Vec<FaultResponse> = numbers.chunks_exact(b + n).enumerate().map(fault).collect();
    for (of, shift) in faults.iter_mut().filter(|of| may_shift(of)).zip(shifts.chunks_exact(b)) {
        of.shift = shift.to_vec();
    }
    rest.is_empty().then_some(ChannelResponse { parameters, faults })
}

#[cfg(test)]
mod tests {
    use super::*;
    use armwatch_model::robot::ParameterKind;

    #[test]
    fn a_response_comes_back() {
        let joint = JointIndex::new(1);
        let parameters: Vec<ParameterId> =
            (0..5).map(|k| ParameterId { joint, kind: ParameterKind::Inertial(k) }).collect();
        let fault = |kind: ChannelFault, place: usize, shifts: bool| FaultResponse {
            joint: JointIndex::new(place % 3),
            strength: place / 3,
            fault: kind,
            change: (0..5).map(|k| f64::from(k) * 0.25 - place as f64).collect(),
            shift: match shifts && kind == ChannelFault::TorqueOffset && place >= 3 {
                true => (0..5).map(|k| f64::from(k) + 0.5 * place as f64).collect(),
                false => Vec::new(),
            },
            unexplained: vec![0.5, 0.125, place as f64],
        };
        // rows of earlier versions have none
        for shifts in [true, false] {
            let of_kind = |kind| (0..9).map(move |place| fault(kind, place, shifts));
            let faults = ChannelFault::ALL.into_iter().flat_map(of_kind).collect();
            let response = ChannelResponse { parameters: parameters.clone(), faults };
            let bytes = packed(&response);
            assert_eq!(bytes.len(), 4 * (9 * 3 * (5 + 3) + if shifts { 2 * 3 * 5 } else { 0 }));
            assert_eq!(unpacked(parameters.clone(), &bytes), Some(response));
            assert_eq!(unpacked(parameters.clone(), &bytes[1..]), None);
        }
        assert_eq!(unpacked(parameters, &[]), None);
    }
}
