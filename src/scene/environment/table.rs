//! A piecewise constant density on a line: sampled by inverting its cumulative sum.

/// Cumulative sums of `weights`, normalised: one more than there are weights, from exactly 0 to exactly 1. All zeros but the
/// last if every weight is 0.
pub(super) fn accumulate(weights: impl Iterator<Item = f64> + Clone, into: &mut Vec<f64>) -> f64 {
    let total: f64 = weights.clone().sum();
    let start = into.len();
    into.push(0.0);
    let mut sum = 0.0;
    for weight in weights {
        sum += weight;
        into.push(if total > 0.0 { (sum / total).min(1.0) } else { 0.0 });
    }
    if into.len() > start + 1
        && let Some(last) = into.last_mut()
    {
        *last = 1.0;
    }
    total
}

/// The interval of `sums` that holds `u` in 0 .. 1, and where in it `u` lies. Intervals without weight are never chosen.
pub(super) fn invert(sums: &[f64], u: f64) -> (usize, f64) {
    // The last sum is 1, above u; the first 0, not above it.
    let after = sums.partition_point(|sum| *sum <= u).clamp(1, sums.len() - 1);
    let (low, high) = (sums[after - 1], sums[after]);
    (after - 1, ((u - low) / (high - low)).clamp(0.0, 1.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn intervals_are_chosen_by_weight() {
        let mut sums = vec![7.0];
        let weights = [0.0, 1.0, 0.0, 3.0, 0.0];
        assert_eq!(accumulate(weights.iter().copied(), &mut sums), 4.0);
        let sums = &sums[1..];
        assert_eq!(sums, [0.0, 0.0, 0.25, 0.25, 1.0, 1.0]);
        let mut counts = [0; 5];
        for step in 0..1000 {
            let (index, inside) = invert(sums, f64::from(step) / 1000.0);
            assert!((0.0..=1.0).contains(&inside));
            counts[index] += 1;
        }
        assert_eq!(counts, [0, 250, 0, 750, 0]);
        assert_eq!(invert(sums, 0.625), (3, 0.5));
    }
}
