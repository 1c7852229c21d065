//! Checks that shots of one subject agree within the changes due to mountings and lamps, and leaves out single shots that
//! do not.

use crate::board::Board;
use crate::least_squares::{finite_mean, median};
use crate::refusal::{Refusal, TURNED, UNLIKE};
use crate::report::ShotReport;

/// Fewest shots that must remain when others are left out.
pub(crate) const LEAST: usize = 2;

/// Root mean square deviation from the other shots above which a shot is left out, as a share of the bare board's
/// contrast.
const APART: f64 = 0.05;

/// Fall from the dark to the light side that exceeds noise, as a share of the bare board's contrast.
const FALLS: f64 = 0.01;

/// A profile divided by this is the part at each end that represents a side.
const END: usize = 3;

/// Refuses a shot whose light side is darker than its dark side in all channels.
pub(crate) fn check_sides(shot: &ShotReport, board: &Board) -> Result<(), Refusal> {
    let rise = |c: usize| {
        let values = &shot.profiles[c].values;
        let n = values.len() / END;
        (finite_mean(&values[values.len() - n..]) - finite_mean(&values[..n])) / contrast(board, c)
    };
    let rises: Vec<f64> = (0..shot.profiles.len()).map(rise).collect();
    if rises.iter().any(|rise| *rise > -FALLS) {
        return Ok(());
    }
    let seen = format!(
        "brightness falls from the board's dark to its light side, by {:.1} %",
        -100.0 * rises[rises.len() / 2]
    );
    Err(Refusal::Unlike { label: shot.label.clone(), seen, cause: TURNED })
}

/// Leaves out shots that deviate from the others. Refuses them if too few shots would remain.
pub(crate) fn leave_out(
    shots: &mut Vec<ShotReport>,
    board: &Board,
) -> Result<Vec<(usize, Refusal)>, Refusal> {
    let mut left_out = Vec::new();
    while shots.len() >= LEAST {
        let apart: Vec<f64> = (0..shots.len()).map(|j| apart(shots, j, board)).collect();
        let worst = (0..shots.len()).max_by(|a, b| apart[*a].total_cmp(&apart[*b])).unwrap_or(0);
        if apart[worst] <= APART {
            break;
        }
        let seen = format!(
            "the profile differs from the other shots' by {:.1} % of the board's contrast, {:.0} % are allowed",
            100.0 * apart[worst],
            100.0 * APART
        );
        let refusal = Refusal::Unlike { label: shots[worst].label.clone(), seen, cause: UNLIKE };
        if shots.len() <= LEAST {
            return Err(refusal);
        }
        shots.remove(worst);
        left_out.push((worst, refusal));
    }
    Ok(left_out)
}

/// Deviation of shot `j` from the median of the others, in the channel where it is largest.
fn apart(shots: &[ShotReport], j: usize, board: &Board) -> f64 {
    let deviation = |c: usize| {
        let off = |k: usize| {
            let others =
                shots.iter().enumerate().filter(|(i, _)| *i != j).map(|(_, s)| s.profiles[c].values[k]);
            let mut others: Vec<f64> = others.filter(|v| v.is_finite()).collect();
            shots[j].profiles[c].values[k] - median(&mut others)
        };
        let all: Vec<f64> =
            (0..shots[j].profiles[c].values.len()).map(off).filter(|v| v.is_finite()).collect();
        let mean = all.iter().map(|v| v * v).sum::<f64>() / all.len().max(1) as f64;
        mean.sqrt() / contrast(board, c)
    };
    (0..shots[j].profiles.len()).map(deviation).fold(0.0, f64::max)
}

fn contrast(board: &Board, c: usize) -> f64 {
    board.light[c].value - board.dark[c].value
}
