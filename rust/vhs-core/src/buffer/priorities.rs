//! Priorities of steps, and their sums.
//!
//! A step is drawn with the odds p^alpha; new ones have the largest that any step ever had. The steps of all episodes
//! that ever finished are numbered one after the other, and those stored are the newest of them: a step's leaf in the
//! tree of sums is its number modulo the leaves, so that nothing moves and no list says which leaf is whose.

use vhs_base::check::with_room;
use vhs_base::error::Result;

/// Leaves that take 16 MB.
const CHEAP_LEAVES: usize = 1 << 20;

/// Priorities of the finished steps of a buffer.
#[derive(Debug)]
pub(crate) struct Priorities {
    /// alpha.
    exponent: f64,
    /// The largest priority that a step ever had, raised to alpha.
    pub(crate) largest: f64,
    tree: SumTree,
}

impl Priorities {
    pub(crate) const fn new(exponent: f64) -> Self {
        Self {
            exponent,
            largest: 1.0,
            tree: SumTree {
                leaves: 0,
                nodes: Vec::new(),
            },
        }
    }

    /// Makes room for so many stored steps, from number `first` on.
    pub(crate) fn reserve(&mut self, first: u64, stored: usize) -> Result<()> {
        let old = self.tree.leaves;
        if stored <= old {
            return Ok(());
        }
        let grown = SumTree::new(stored.next_power_of_two())?;
        let before = std::mem::replace(&mut self.tree, grown);
        for number in first..first + old as u64 {
            let odds = before.leaf(remainder(number, old));
            self.tree.nodes[self.tree.leaves + remainder(number, self.tree.leaves)] = odds;
        }
        self.tree.sum_all();
        Ok(())
    }

    /// Steps from number `first` on, of an episode that has just finished, get the largest priority.
    pub(crate) fn add(&mut self, first: u64, count: usize) {
        self.fill(first, count, self.largest);
    }

    /// Bytes set aside.
    pub(crate) const fn allocated_bytes(&self) -> usize {
        self.tree.nodes.capacity() * size_of::<f64>()
    }

    /// Leaves of the tree, which the order of draws depends on.
    pub(crate) const fn leaves(&self) -> usize {
        self.tree.leaves
    }

    /// Takes in what a file has: the largest odds ever, the leaves of the tree, and the odds of the steps from number
    /// `first` on. Leaves are believed where they cost little or are of use: a file may say anything.
    pub(crate) fn restore(
        &mut self,
        largest: f64,
        leaves: usize,
        first: u64,
        odds: &[f64],
    ) -> Result<()> {
        self.largest = largest;
        let believed = leaves <= CHEAP_LEAVES.max(4 * odds.len());
        self.reserve(first, if believed { leaves } else { odds.len() })?;
        for (number, &odds) in (first..).zip(odds) {
            self.set_odds(number, odds);
        }
        Ok(())
    }

    /// Steps of an episode that leaves are drawn no more.
    pub(crate) fn remove(&mut self, first: u64, count: usize) {
        self.fill(first, count, 0.0);
    }

    /// Odds of a step, by its number.
    pub(crate) fn odds(&self, number: u64) -> f64 {
        self.tree.leaf(self.leaf(number))
    }

    /// Sets the odds of a step.
    pub(crate) fn set_odds(&mut self, number: u64, odds: f64) {
        let leaf = self.leaf(number);
        self.tree.set(leaf, odds);
    }

    fn fill(&mut self, first: u64, count: usize, odds: f64) {
        if count == 0 {
            return;
        }
        let (start, leaves) = (self.leaf(first), self.tree.leaves);
        let whole = count.min(leaves - start);
        self.tree.fill(start, whole, odds);
        self.tree.fill(0, count - whole, odds);
    }

    /// Gives a step another priority, above 0.
    pub(crate) fn set(&mut self, number: u64, priority: f32) {
        let odds = f64::from(priority).powf(self.exponent);
        self.largest = self.largest.max(odds);
        self.set_odds(number, odds);
    }

    /// The number from `first` on whose step lies at a part of all odds, in 0..1.
    pub(crate) fn find(&self, part: f64, first: u64) -> u64 {
        let leaf = self.tree.find(part * self.tree.total());
        // The one of the next numbers, one a leaf, that has this remainder.
        let ahead = (leaf + self.tree.leaves - self.leaf(first)) % self.tree.leaves;
        first + ahead as u64
    }

    fn leaf(&self, number: u64) -> usize {
        remainder(number, self.tree.leaves)
    }
}

/// The leaf of a number, among so many.
fn remainder(number: u64, leaves: usize) -> usize {
    usize::try_from(number % leaves as u64).unwrap_or_default()
}

/// Numbers of 0 or more, and their sums: that of leaves 2i and 2i + 1, of four, of eight, up to all.
#[derive(Debug)]
struct SumTree {
    /// A power of two, or 0 while nothing is stored; grows with what is stored.
    leaves: usize,
    /// Node 1 is the sum of all, nodes 2i and 2i + 1 are the halves of node i, leaves come last. Sums are always
    /// taken anew, so that nothing drifts.
    nodes: Vec<f64>,
}

impl SumTree {
    fn new(leaves: usize) -> Result<Self> {
        let mut nodes = with_room("priorities", 2 * leaves)?;
        nodes.resize(2 * leaves, 0.0);
        Ok(Self { leaves, nodes })
    }

    fn sum_all(&mut self) {
        for node in (1..self.leaves).rev() {
            self.nodes[node] = self.nodes[2 * node] + self.nodes[2 * node + 1];
        }
    }

    fn total(&self) -> f64 {
        self.nodes[1]
    }

    fn leaf(&self, leaf: usize) -> f64 {
        self.nodes[self.leaves + leaf]
    }

    fn set(&mut self, leaf: usize, number: f64) {
        self.fill(leaf, 1, number);
    }

    /// Sets `count` leaves from `start` on.
    fn fill(&mut self, start: usize, count: usize, number: f64) {
        if count == 0 {
            return;
        }
        let (mut low, mut high) = (self.leaves + start, self.leaves + start + count - 1);
        self.nodes[low..=high].fill(number);
        while low > 1 {
            (low, high) = (low / 2, high / 2);
            for node in low..=high {
                self.nodes[node] = self.nodes[2 * node] + self.nodes[2 * node + 1];
            }
        }
    }

    /// The leaf in which a point of 0..total lies; never one of 0.
    fn find(&self, mut point: f64) -> usize {
        let mut node = 1;
        while node < self.leaves {
            let (left, right) = (self.nodes[2 * node], self.nodes[2 * node + 1]);
            node *= 2;
            if point >= left && right > 0.0 {
                point -= left;
                node += 1;
            }
        }
        node - self.leaves
    }
}
