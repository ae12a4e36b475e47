//! Lists of lists in compressed storage.

/// Lists of entity numbers, stored one behind the other.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Lists {
    offsets: Vec<usize>,
    items: Vec<usize>,
}

impl Default for Lists {
    fn default() -> Self {
        Self { offsets: vec![0], items: Vec::new() }
    }
}

impl Lists {
    /// No list yet.
    pub fn new() -> Self {
        Self::default()
    }

    /// The lists that start in `items` at each of `offsets`, whose last entry is the length of `items`; `None` unless
    /// they start at 0 and do not descend.
    pub fn from_offsets(offsets: Vec<usize>, items: Vec<usize>) -> Option<Self> {
        let sound = offsets.first() == Some(&0) && offsets.last() == Some(&items.len()) && offsets.is_sorted();
        sound.then_some(Self { offsets, items })
    }

    /// Appends one list.
    pub fn push(&mut self, list: impl IntoIterator<Item = usize>) {
        self.items.extend(list);
        self.offsets.push(self.items.len());
    }

    /// Number of lists.
    pub fn len(&self) -> usize {
        self.offsets.len() - 1
    }

    /// Whether there is no list.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The `i`-th list.
    pub fn get(&self, i: usize) -> &[usize] {
        &self.items[self.range(i)]
    }

    /// Where the `i`-th list stands in [`items`](Self::items); arrays aligned with the lists use it.
    pub fn range(&self, i: usize) -> std::ops::Range<usize> {
        self.offsets[i]..self.offsets[i + 1]
    }

    /// All lists, one behind the other.
    pub fn items(&self) -> &[usize] {
        &self.items
    }

    /// The start of each list in [`items`](Self::items), and their total length at the end.
    pub fn offsets(&self) -> &[usize] {
        &self.offsets
    }

    /// The lists in order.
    pub fn iter(&self) -> impl ExactSizeIterator<Item = &[usize]> + Clone {
        (0..self.len()).map(|i| self.get(i))
    }

    pub(crate) fn get_mut(&mut self, i: usize) -> &mut [usize] {
        let range = self.range(i);
        &mut self.items[range]
    }

    /// For every item below `n`, the lists that hold it, in ascending order.
    pub fn transpose(&self, n: usize) -> Lists {
        let mut offsets = vec![0; n + 1];
        for &item in &self.items {
            offsets[item + 1] += 1;
        }
        for i in 0..n {
            offsets[i + 1] += offsets[i];
        }
        let mut next = offsets.clone();
        let mut items = vec![0; self.items.len()];
        for (i, list) in self.iter().enumerate() {
            for &item in list {
                items[next[item]] = i;
                next[item] += 1;
            }
        }
        Lists { offsets, items }
    }
}

impl<L: IntoIterator<Item = usize>> FromIterator<L> for Lists {
    fn from_iter<T: IntoIterator<Item = L>>(lists: T) -> Self {
        let mut result = Lists::new();
        for list in lists {
            result.push(list);
        }
        result
    }
}
