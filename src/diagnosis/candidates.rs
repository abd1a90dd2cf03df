//! The sets of effects that were fitted to a log, and the part of each that may be claimed.

/// Gain below which all gains are alike.
const ALIKE: f64 = 1.0 / 300.0;

/// A set of effects that was fitted and scored.
pub trait Scored {
    /// Names, in catalogue order.
    fn names(&self) -> &[&'static str];
    /// Mean square that it leaves on parts of the log that the fit has not seen.
    fn energy(&self) -> f64;
    /// What it explains beyond another set, in units of the least that is claimed.
    fn gain(&self, beyond: &Self) -> f64;
    /// Part of a gap that it closes beyond another set.
    fn closed(&self, beyond: &Self, gap: f64) -> f64 {
        ((beyond.energy() - self.energy()) / gap).clamp(-1.0, 1.0)
    }
}

/// All sets of a search.
#[derive(Debug, Clone)]
pub struct Candidates<C> {
    /// The nominal model.
    pub nominal: C,
    /// Every single effect, best first.
    pub singles: Vec<C>,
    /// Fitted pairs and triples, best first.
    pub larger: Vec<C>,
}

impl<C: Scored> Candidates<C> {
    /// Adds larger sets; of those with the same effects the better one stays.
    pub fn add(&mut self, sets: impl IntoIterator<Item = C>) {
        for set in sets.into_iter().filter(|s| s.names().len() > 1) {
            let mut larger = self.larger.iter_mut();
            match larger.find(|known| known.names() == set.names()) {
                Some(known) if known.energy() <= set.energy() => {}
                Some(known) => *known = set,
                None => self.larger.push(set),
            }
        }
        let larger = &mut self.larger;
        larger.sort_by(|a, b| a.energy().total_cmp(&b.energy()));
    }

    /// All sets of effects.
    pub fn sets(&self) -> impl Iterator<Item = &C> {
        self.singles.iter().chain(&self.larger)
    }

    /// The candidate of these effects, if it was fitted.
    pub fn set(&self, names: &[&str]) -> Option<&C> {
        let mut all = self.sets().chain([&self.nominal]);
        all.find(|c| c.names() == names)
    }

    /// The candidate with all effects of a set but one, if it was fitted.
    pub fn without(&self, c: &C, name: &str) -> Option<&C> {
        let rest: Vec<&str> = c.names().iter().copied().filter(|n| *n != name).collect();
        self.set(&rest)
    }

    /// The sets that lack one effect of a set.
    pub fn parts<'a>(&'a self, c: &'a C) -> impl Iterator<Item = &'a C> {
        c.names().iter().filter_map(|n| self.without(c, n))
    }

    /// The part of a set that may be claimed: each of its effects explains `enough` beyond the others.
    pub fn claimable<'a>(&'a self, c: &'a C, enough: &impl Fn(&C, &C) -> bool) -> &'a C {
        if self.parts(c).all(|part| enough(c, part)) {
            return c;
        }
        let parts = self.parts(c);
        let best = parts.min_by(|a, b| a.energy().total_cmp(&b.energy()));
        best.map_or(&self.nominal, |part| self.claimable(part, enough))
    }

    /// Logarithms, where they are negative, of what a set explains beyond the nominal model, and of the least that one of several effects
    /// explains beyond the others.
    pub fn claims(&self, c: &C) -> [f64; 2] {
        let claim = |part: &C| c.gain(part).max(ALIKE).ln().min(0.0);
        let parts = self.parts(c).filter(|part| !part.names().is_empty());
        [claim(&self.nominal), parts.map(claim).fold(0.0, f64::min)]
    }
}
