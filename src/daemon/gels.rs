//! The gels of the rig: their state, and their change since the initial frame.

use std::collections::BTreeMap;

use image::RgbImage;

use gripcast_imaging::{
    ChangeKind, GelCells, GelChange, GelMonitor, GelProblem, GelState, MIN_CONTACT_FRACTION, Role,
};

/// Minimum fraction of a gel that is different for a mark, 0 to 1.
const MIN_MARKED_FRACTION: f64 = 0.01;
/// Time after which a difference counts as a mark, ns.
const MARKED_NS: u64 = 3_000_000_000;
/// Time for which both gels look like the other one until they count as swapped, ns. A finger that
/// closes may do so for a few frames.
const SWAPPED_NS: u64 = 300_000_000;
/// Maximum age difference of the newest images of both gels for a comparison, ns.
const MAX_AGE_DIFFERENCE_NS: u64 = 200_000_000;

/// Judges the images of both gels.
#[derive(Debug, Default)]
pub(super) struct GelJudge {
    monitors: BTreeMap<Role, GelMonitor>,
    /// Newest noise of each gel, grey levels.
    noise_levels: BTreeMap<Role, f32>,
    reference: GelReference,
}

impl GelJudge {
    /// Sets the images of the left and the right gel with an open gripper, of an initial frame.
    pub(super) fn set_initial(&mut self, images: [&RgbImage; 2]) {
        self.reference = GelReference::new(cells_by_role(images));
    }

    /// Returns the state of a gel after its newest image, and its change since the initial frame,
    /// if any; without a pending initial frame (`is_open`), the gel is compared with an earlier one.
    pub(super) fn judge(
        &mut self,
        role: Role,
        image: &RgbImage,
        time_ns: u64,
        is_open: bool,
    ) -> Option<(GelState, Option<GelChange>)> {
        let cells = GelCells::new(image).ok()?;
        let change = self.change_of(role, &cells);
        let problems = match is_open {
            true => self.reference.problems(role, &cells, time_ns),
            false => Vec::new(),
        };
        let monitor = self.monitors.entry(role).or_default();
        if change.is_some_and(|c| c.kind(MIN_CONTACT_FRACTION) == ChangeKind::Contact) {
            // Fingers that close and open again are not flicker.
            monitor.restart();
        }
        let mut gel = monitor.add(cells, time_ns).clone();
        gel.problems.extend(problems);
        if let Some(noise_levels) = gel.noise_levels {
            self.noise_levels.insert(role, noise_levels);
        }
        Some((gel, change))
    }

    /// Returns the change of a gel in an image since the initial frame.
    pub(super) fn change(&self, role: Role, image: &RgbImage) -> Option<GelChange> {
        self.change_of(role, &GelCells::new(image).ok()?)
    }

    fn change_of(&self, role: Role, cells: &GelCells) -> Option<GelChange> {
        let initial = self.reference.cells.get(&role)?;
        let noise_levels = self.noise_levels.get(&role).copied();
        Some(GelChange::between(
            initial,
            cells,
            noise_levels.unwrap_or_default(),
        ))
    }
}

/// Reduces the images of the left and the right gel; too small ones are omitted.
fn cells_by_role([left, right]: [&RgbImage; 2]) -> BTreeMap<Role, GelCells> {
    let images = [(Role::Left, left), (Role::Right, right)].into_iter();
    images
        .filter_map(|(role, image)| Some((role, GelCells::new(image).ok()?)))
        .collect()
}

/// The gels of the pending or else the last initial frame.
#[derive(Debug, Default)]
struct GelReference {
    cells: BTreeMap<Role, GelCells>,
    /// Driver times of the first and the newest of the images of each gel that are those of the
    /// other, ns.
    swapped_ns: BTreeMap<Role, (u64, u64)>,
    /// Driver time since which a part of a gel is different, ns.
    marked_since_ns: BTreeMap<Role, u64>,
}

impl GelReference {
    fn new(cells: BTreeMap<Role, GelCells>) -> Self {
        Self {
            cells,
            ..Self::default()
        }
    }

    /// Compares the newest image of a gel with both references.
    fn problems(&mut self, role: Role, cells: &GelCells, time_ns: u64) -> Vec<GelProblem> {
        let other = match role {
            Role::Left => Role::Right,
            _ => Role::Left,
        };
        let change = |role| Some(GelChange::between(self.cells.get(&role)?, cells, 0.0));
        let (Some(own), Some(other)) = (change(role), change(other)) else {
            return Vec::new();
        };
        if GelChange::is_swapped(&own, &other) {
            let (_, newest_ns) = self.swapped_ns.entry(role).or_insert((time_ns, time_ns));
            *newest_ns = time_ns;
        } else {
            self.swapped_ns.remove(&role);
        }
        let is_marked = own.kind(MIN_MARKED_FRACTION) == ChangeKind::Contact;
        let since_ns = match is_marked {
            true => *self.marked_since_ns.entry(role).or_insert(time_ns),
            false => {
                self.marked_since_ns.remove(&role);
                time_ns
            }
        };
        let stays = time_ns.saturating_sub(since_ns) >= MARKED_NS;
        let problems = [
            (GelProblem::Swapped, self.are_swapped()),
            (GelProblem::Marked, stays && !self.are_swapped()),
        ];
        problems.into_iter().filter(|p| p.1).map(|p| p.0).collect()
    }

    /// Whether both gels look like the other one at the same time, for long enough.
    fn are_swapped(&self) -> bool {
        let mut gels = self.swapped_ns.values();
        let (Some(a), Some(b)) = (gels.next(), gels.next()) else {
            return false;
        };
        a.1.abs_diff(b.1) <= MAX_AGE_DIFFERENCE_NS
            && [a, b]
                .iter()
                .all(|gel| gel.1.saturating_sub(gel.0) >= SWAPPED_NS)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use gripcast_imaging::synthetic_gel;

    #[test]
    fn swapped_and_marked_gels_are_named() {
        let tinted = |role: Role, seed: u64, contact: f32| {
            let mut image = synthetic_gel(160, 120, seed, contact);
            if role == Role::Right {
                image.pixels_mut().for_each(|pixel| pixel.0[2] -= 20);
            }
            GelCells::new(&image).unwrap()
        };
        let both = [Role::Left, Role::Right];
        let cells = both.map(|role| (role, tinted(role, 1, 0.0)));
        let mut reference = GelReference::new(cells.into());
        let mut problems = |left: GelCells, right: GelCells, time_ns: u64| {
            reference.problems(Role::Left, &left, time_ns);
            let right = reference.problems(Role::Right, &right, time_ns);
            (reference.problems(Role::Left, &left, time_ns), right)
        };
        let [left, right] = both.map(|role| tinted(role, 2, 0.0));
        let none = (vec![], vec![]);
        assert_eq!(problems(left.clone(), right.clone(), 0), none);
        let swapped = (vec![GelProblem::Swapped], vec![GelProblem::Swapped]);
        assert_eq!(problems(right.clone(), left.clone(), 1), none, "one frame");
        assert_eq!(
            problems(right.clone(), left.clone(), 1 + SWAPPED_NS),
            swapped
        );
        let mark = tinted(Role::Left, 3, 0.5);
        let mark_ns = 2 + SWAPPED_NS;
        assert_eq!(problems(mark.clone(), right.clone(), mark_ns), none);
        let marked = (vec![GelProblem::Marked], vec![]);
        assert_eq!(problems(mark, right.clone(), mark_ns + MARKED_NS), marked);
        assert_eq!(problems(left, right, mark_ns + MARKED_NS + 1), none);
    }

    #[test]
    fn gels_that_look_swapped_one_after_the_other_are_not() {
        let gel = |seed: u64, contact: f32| {
            GelCells::new(&synthetic_gel(160, 120, seed, contact)).unwrap()
        };
        // Reference: the left finger is closed, the right one open.
        let mut reference =
            GelReference::new([(Role::Left, gel(1, 0.8)), (Role::Right, gel(1, 0.0))].into());
        // The left camera shows the open finger and stops, then the right one the closed finger.
        let mut problems = Vec::new();
        for frame in 0..100 {
            problems.extend(reference.problems(Role::Left, &gel(2, 0.0), frame * 10_000_000));
        }
        for frame in 150..250 {
            problems.extend(reference.problems(Role::Right, &gel(3, 0.8), frame * 10_000_000));
        }
        assert_eq!(problems, [GelProblem::Marked; 0]);
    }
}
