//! From a scenario to a world that can run.

use robot_model::RobotModel;

use super::Scenario;
use super::host::ScriptedHost;
use crate::bus::BusConfig;
use crate::cell::{Cell, CellError};
use crate::checker::{Checkers, ModuleLimits};
use crate::participants::{Participants, Solo};
use crate::world::{self, World};

/// Why a scenario cannot run.
#[derive(Debug, thiserror::Error)]
pub enum BuildError {
    /// The robot file is refused.
    #[error("{0}")]
    Robot(#[from] robot_model::LoadError),
    /// The robot makes no cell.
    #[error("{file}: {error}")]
    Cell { file: String, error: CellError },
    /// The bus cannot carry it.
    #[error("{file}: {error}")]
    World { file: String, error: world::BuildError },
}

impl BuildError {
    /// What to do.
    #[must_use]
    pub fn next(&self) -> Option<String> {
        match self {
            Self::Robot(error) => error.problem.next(),
            Self::Cell { .. } | Self::World { .. } => None,
        }
    }
}

/// Six drives and the nodes that talk to them.
pub type CellWith<N> = (Cell, Solo<N>);

impl Scenario {
    /// The cell, seeded.
    pub fn cell(&self) -> Result<Cell, BuildError> {
        let robot = RobotModel::load(&self.robot)?;
        Cell::new(&robot, &self.cell, self.seed)
            .map_err(|error| BuildError::Cell { file: self.file.clone(), error })
    }

    /// The cell on its bus with the scenario's faults, and further nodes beside it.
    pub fn world_with<C: Participants>(&self, others: C) -> Result<World<(Cell, C)>, BuildError> {
        World::new((self.cell()?, others), self.bus, self.seed, self.faults.clone())
            .map_err(|error| BuildError::World { file: self.file.clone(), error })
    }

    pub fn world(&self) -> Result<World<CellWith<ScriptedHost>>, BuildError> {
        self.world_with(Solo::new("host", ScriptedHost::new(&self.actions)))
    }

    pub fn checkers(&self, cell: &Cell) -> Checkers {
        let data_bit_rate_bit_s = cell.data_bit_rate_bit_s();
        Checkers::new(&self.expect, &limits_of(cell), &BusConfig { data_bit_rate_bit_s, ..self.bus })
    }
}

/// Limits of the drives of a cell, by their nameplates.
pub fn limits_of(cell: &Cell) -> Vec<ModuleLimits> {
    cell.drives()
        .iter()
        .map(|drive| {
            let plate = drive.nameplate();
            ModuleLimits {
                module: plate.address,
                q_min_rad: plate.q_min_rad,
                q_max_rad: plate.q_max_rad,
                v_max_rad_s: plate.v_max_rad_s,
                a_max_rad_s2: plate.a_max_rad_s2,
                current_max_a: plate.current_max_a,
            }
        })
        .collect()
}
