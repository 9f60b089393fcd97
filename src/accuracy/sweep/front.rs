//! Which settings are worth their time, and what halving the error costs along them.

/// Which of `points` (cost, error) no other point beats in one without losing in the other, from the cheapest to the most accurate. Of
/// equal points the first is taken.
pub fn pareto_front(points: &[[f64; 2]]) -> Vec<usize> {
    let mut order: Vec<usize> = (0..points.len()).collect();
    order.sort_by(|&a, &b| points[a][0].total_cmp(&points[b][0]).then(points[a][1].total_cmp(&points[b][1])));
    let mut least = f64::INFINITY;
    order.retain(|&index| {
        let is_better = points[index][1] < least;
        least = least.min(points[index][1]);
        is_better
    });
    order
}

/// What halving the error costs along a front: for each step, from the cheapest point's error on, the error to halve, and the seconds
/// before and after, interpolated between the points on logarithmic scales.
///
/// `front` is as [`pareto_front`] gives it: cost rising, error falling. Steps end where the front does; points without error or cost do not
/// take part.
pub fn halving_costs(front: &[[f64; 2]]) -> Vec<Halving> {
    let front: Vec<[f64; 2]> =
        front.iter().copied().filter(|[cost, error]| *cost > 0.0 && *error > 0.0).collect();
    let cost_at = |error: f64| {
        front.windows(2).find(|pair| (pair[1][1]..=pair[0][1]).contains(&error)).map(|pair| {
            let [[cost_a, error_a], [cost_b, error_b]] = [pair[0], pair[1]].map(|point| point.map(f64::ln));
            let share = if error_a == error_b { 0.0 } else { (error_a - error.ln()) / (error_a - error_b) };
            (cost_a + share * (cost_b - cost_a)).exp()
        })
    };
    let mut steps = Vec::new();
    let mut error = front.first().map_or(0.0, |first| first[1]);
    while let (Some(from), Some(to)) = (cost_at(error), cost_at(0.5 * error)) {
        steps.push(Halving { error, seconds: [from, to] });
        error *= 0.5;
    }
    steps
}

/// One halving of the error.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Halving {
    /// The error that is halved.
    pub error: f64,
    /// Seconds for it, and for half of it.
    pub seconds: [f64; 2],
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_front_holds_what_nothing_beats() {
        let points = [[1.0, 8.0], [2.0, 4.0], [2.0, 5.0], [3.0, 4.0], [4.0, 1.0], [0.5, 9.0], [4.0, 1.0]];
        assert_eq!(pareto_front(&points), [5, 0, 1, 4]);
        assert!(pareto_front(&[]).is_empty());
    }

    #[test]
    fn halving_follows_a_power_law() {
        // Error = cost^-3/4: half the error costs 2^(4/3) times as much.
        let front: Vec<[f64; 2]> =
            (0..9).map(|k| f64::from(1 << k)).map(|cost| [cost, cost.powf(-0.75)]).collect();
        let steps = halving_costs(&front);
        assert_eq!(steps.len(), 6);
        for step in steps {
            assert!((step.seconds[1] / step.seconds[0] - 2f64.powf(4.0 / 3.0)).abs() < 1e-9, "{step:?}");
        }
        assert!(halving_costs(&[[1.0, 1.0]]).is_empty() && halving_costs(&[]).is_empty());
        // A front that ends without error ends the steps.
        assert_eq!(halving_costs(&[[1.0, 1.0], [2.0, 0.4], [3.0, 0.0]]).len(), 1);
    }
}
