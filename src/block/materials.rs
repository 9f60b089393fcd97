//! Materials as runs: two bytes for the material, two for how many triangles have it less one.

use super::Fault;

/// Appends the runs and returns how many there are.
pub(super) fn encode(materials: &[u16], out: &mut Vec<u8>) -> usize {
    let mut runs = 0;
    for run in materials.chunk_by(|a, b| a == b) {
        out.extend_from_slice(&run[0].to_le_bytes());
        // A block has at most 16,384 triangles.
        out.extend_from_slice(&((run.len() - 1) as u16).to_le_bytes());
        runs += 1;
    }
    runs
}

/// Fills `materials` from the runs and checks that all lie in `range`.
///
/// Errors carry offsets into `runs`.
pub(super) fn decode(runs: &[u8], range: [u16; 2], materials: &mut [u16]) -> Result<(), Fault> {
    let mut rest = materials;
    for (number, &[a, b, c, d]) in runs.as_chunks::<4>().0.iter().enumerate() {
        let (material, count) = (u16::from_le_bytes([a, b]), usize::from(u16::from_le_bytes([c, d])) + 1);
        if material < range[0] || material > range[1] {
            return Err(Fault(4 * number, "a material is outside the range of the directory"));
        }
        let (run, after) =
            rest.split_at_mut_checked(count).ok_or(Fault(4 * number, "a run of a material is too long"))?;
        run.fill(material);
        rest = after;
    }
    if rest.is_empty() {
        Ok(())
    } else {
        Err(Fault(runs.len(), "its material runs do not cover its triangles"))
    }
}
