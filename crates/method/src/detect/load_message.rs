//! What an alarm says of a load.

/// Sentence about `mass`, kg, that an arm carries more than in its first tests, or less if it is negative. `error` says how
/// well it is known; the centre, m, is in the frame that is named with it.
#[must_use]
pub fn load_message(mass: f64, error: &str, centre: Option<([f64; 3], &str)>) -> String {
    let (amount, verb, advice) = match mass > 0.0 {
        true => (mass, "more", "take the tool or workpiece off for tests, declare it with [[tool]],"),
        false => (-mass, "less", "look for a tool or part that was lost or taken off,"),
    };
    let centre = centre.map_or_else(String::new, |(centre, frame)| {
        // to the millimetre, without the sign of a zero
        let [x, y, z] = centre.map(|part| (1e3 * part).round() / 1e3 + 0.0);
        format!(", centre at ({x:.3}, {y:.3}, {z:.3}) m of the {frame}")
    });
    format!(
        "the arm carries {amount:.2} kg {verb} than in its first tests ({error}){centre}; {advice} or record the new tool as \
         maintenance"
    )
}
