//! Draws the jobs of a dictionary as a grid that fills: σ_t across, all other axes down.

use farm_proto::status::JobState;
use optics_model::Grid;

/// Largest number of rows; in a larger grid, several rows of jobs share one.
const ROWS: usize = 16;

/// Meaning of the characters.
pub(super) const LEGEND: &str = "σ_t →   █ done   ▒ in part   + computing   · waiting   × failed";

/// The states of the jobs on a grid's axes.
#[derive(Debug)]
pub(crate) struct Cells {
    states: Vec<JobState>,
    /// Number of values of σ_t (for each refractive index), and of jobs of each.
    columns: usize,
    of_column: usize,
}

impl Cells {
    pub fn new(grid: &Grid) -> Self {
        let columns = grid.sigma_t_per_mm().len() * grid.sample_ior().len();
        let jobs = grid.nominal_jobs();
        Self { states: vec![JobState::Waiting; jobs], columns, of_column: jobs / columns }
    }

    /// Sets the states from one job on; states beyond the grid's axes are ignored.
    pub fn set(&mut self, first: usize, states: &[JobState]) {
        for (known, state) in self.states.iter_mut().skip(first).zip(states) {
            *known = *state;
        }
    }

    /// Lines of at most `width` characters, each of which represents one or more jobs.
    pub fn lines(&self, width: usize) -> Vec<String> {
        let wide = self.columns.div_ceil(width.max(1));
        let high = self.of_column.div_ceil(ROWS);
        let cell = |row: usize, column: usize| {
            let columns = column * wide..((column + 1) * wide).min(self.columns);
            let rows = row * high..((row + 1) * high).min(self.of_column);
            let jobs = columns.flat_map(|column| rows.clone().map(move |row| column * self.of_column + row));
            character(jobs.map(|job| self.states[job]))
        };
        let columns = self.columns.div_ceil(wide);
        (0..self.of_column.div_ceil(high)).map(|row| (0..columns).map(|c| cell(row, c)).collect()).collect()
    }
}

fn character(states: impl Iterator<Item = JobState>) -> char {
    let (mut all, mut done, mut computing) = (0, 0, 0);
    for state in states {
        all += 1;
        match state {
            JobState::Failed => return '×',
            JobState::Done | JobState::Checked => done += 1,
            JobState::Computing => computing += 1,
            JobState::Waiting => {}
        }
    }
    match (done, computing) {
        (0, 0) => '·',
        (0, _) => '+',
        (done, _) if done == all => '█',
        _ => '▒',
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn set(cells: &mut Cells, jobs: &[usize], state: JobState) {
        for job in jobs {
            cells.set(*job, &[state]);
        }
    }

    /// 38 values of σ_t, 11 of g and 2 thicknesses: two jobs share a cell.
    #[test]
    fn paper_grid_has_a_cell_per_anisotropy() {
        let mut cells = Cells::new(&Grid::paper());
        set(&mut cells, &[0, 1, 22, 23], JobState::Done);
        set(&mut cells, &[2], JobState::Computing);
        set(&mut cells, &[4], JobState::Failed);
        set(&mut cells, &[6], JobState::Checked);
        let lines = cells.lines(80);
        assert_eq!((lines.len(), lines[0].chars().count()), (11, 38));
        let start = |line: usize| lines[line].chars().take(3).collect::<String>();
        assert_eq!([start(0), start(1), start(2), start(3)], ["██·", "+··", "×··", "▒··"]);
    }

    /// More jobs share a cell on a narrow terminal.
    #[test]
    fn small_terminals_share_cells() {
        let mut cells = Cells::new(&Grid::paper());
        cells.set(0, &[JobState::Done; 22]);
        cells.set(22, &[JobState::Computing]);
        let lines = cells.lines(20);
        assert_eq!((lines.len(), lines[0].chars().count()), (11, 19));
        assert!(lines.iter().all(|line| line.starts_with("▒·")), "{lines:#?}");
        // States beyond the grid's axes are ignored.
        cells.set(800, &[JobState::Done; 500]);
        assert!(cells.lines(10).iter().all(|line| line.chars().count() <= 10));
        assert_eq!(cells.lines(0).len(), 11, "a terminal without a width");
    }
}
