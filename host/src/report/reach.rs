//! HTML page with the reach of a sweep: one cell per target, coloured by the objective; cells out of reach stay grey.

use serde::Serialize;

use super::page::{Answer, Block, Page, Tile, Tone};

/// One target of a sweep.
#[derive(Debug, Clone, PartialEq)]
pub struct Cell {
    /// Target in m.
    pub target: [f64; 3],
    /// Objective, if a throw was found.
    pub objective: Option<f64>,
}

/// Cells over the two coordinates that vary most.
#[derive(Debug, Clone, Serialize)]
pub(super) struct Map {
    x_label: String,
    y_label: String,
    /// Width and height of a cell, m.
    step: [f64; 2],
    cells: Vec<Placed>,
}

#[derive(Debug, Clone, Serialize)]
struct Placed {
    at: [f64; 2],
    value: Option<f64>,
    /// The whole target, m.
    target: [f64; 3],
}

/// One self-contained HTML file of the targets of a grid.
///
/// If the third coordinate varies too, a cell shows the cheapest throw along it.
#[must_use]
pub fn html(cells: &[Cell], robot: &str) -> String {
    let axes = [0, 1, 2].map(|axis| {
        let mut values: Vec<f64> = cells.iter().map(|cell| cell.target[axis]).collect();
        values.sort_by(f64::total_cmp);
        values.dedup();
        values
    });
    let mut order = [0, 1, 2];
    order.sort_by_key(|axis| std::cmp::Reverse(axes[*axis].len()));
    let ([mut a, mut b, c], name) = (order, ["x", "y", "z"]);
    if a > b {
        (a, b) = (b, a);
    }
    let third = match axes[c][..] {
        [from, .., to] => format!("the cheapest of {} = {from} to {to} m", name[c]),
        [only] => format!("{} = {only} m", name[c]),
        [] => String::new(),
    };
    let step = |axis: usize| axes[axis].windows(2).map(|pair| pair[1] - pair[0]).reduce(f64::min);
    let width = step(a).unwrap_or(0.1);
    // Drawn from the dearest to the cheapest, what is out of reach first.
    let price = |cell: &Placed| cell.value.unwrap_or(f64::INFINITY);
    let placed = |cell: &Cell| Placed {
        at: [cell.target[a], cell.target[b]],
        value: cell.objective,
        target: cell.target,
    };
    let mut placed: Vec<Placed> = cells.iter().map(placed).collect();
    placed.sort_by(|a, b| price(b).total_cmp(&price(a)));
    let thrown = cells.iter().filter(|cell| cell.objective.is_some()).count();
    let answer = Answer::new(
        format!("{thrown} of {} targets have a throw", cells.len()),
        Tone::Plain,
        format!("objective of the best throw, {third}"),
        "point at a cell for its target; the rows of the parts have the throws",
    );
    let mut page = Page::new(&format!("Reach of {robot}"), "", &answer);
    let objectives = || cells.iter().filter_map(|cell| cell.objective);
    let mut tiles = vec![Tile::new(thrown, "", format!("throws, of {} targets", cells.len()))];
    let tile = |objective: f64, what| Tile::new(format!("{objective:.2}"), "", what);
    tiles.extend(objectives().reduce(f64::min).map(|least| tile(least, "least objective")));
    tiles.extend(objectives().reduce(f64::max).map(|most| tile(most, "largest objective")));
    page.tiles(tiles);
    let label = |axis: usize| format!("{} of the target in m", name[axis]);
    page.push(Block::Map(Map {
        x_label: label(a),
        y_label: label(b),
        step: [width, step(b).unwrap_or(width)],
        cells: placed,
    }));
    page.finish()
}
