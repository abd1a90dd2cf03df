//! How far the memory can be trusted after a restart.

use crate::service::store::{Found, Recall};
use serde::{Deserialize, Serialize};

/// How far a remembered position can be trusted.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Belief {
    /// Nothing has moved the pistons since it was written.
    Certain,
    /// The drivers were armed afterwards: the measured pose decides.
    Checked,
    /// Nothing tells where the pistons are.
    Lost,
}

impl Belief {
    /// The belief in what was recalled.
    pub fn in_recall(recall: &Recall) -> Self {
        match (recall.found, &recall.memory) {
            (Found::Intact, Some(memory))
                if !memory.lost && (!memory.armed || memory.restart.is_some()) =>
            {
                if memory.armed {
                    Self::Checked
                } else {
                    Self::Certain
                }
            }
            _ => Self::Lost,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::service::memory::Memory;

    #[test]
    fn only_an_intact_memory_is_believed() {
        let recall = |found, armed, lost| Recall {
            memory: Some(Memory {
                armed,
                lost,
                ..Memory::default()
            }),
            damaged: vec![],
            found,
            sequence: 1,
        };
        assert_eq!(
            Belief::in_recall(&Recall::default()),
            Belief::Lost,
            "a machine without a memory"
        );
        assert_eq!(
            Belief::in_recall(&recall(Found::Intact, false, false)),
            Belief::Certain
        );
        for bad in [
            recall(Found::Intact, true, false),
            recall(Found::Intact, false, true),
            recall(Found::Damaged, false, false),
        ] {
            assert_eq!(Belief::in_recall(&bad), Belief::Lost, "{bad:?}");
        }
    }
}
