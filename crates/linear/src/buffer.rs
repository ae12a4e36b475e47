//! Large arrays that do not live long.

use std::alloc::{Layout, handle_alloc_error};
use std::marker::PhantomData;
use std::ops::{Deref, DerefMut};

use bytemuck::Pod;
use memmap2::MmapMut;

/// Bytes from which large pages are worth their making.
#[cfg(target_os = "linux")]
const LARGE: usize = 1 << 21;

/// An array in pages of its own, which go back to the system when it is dropped. What the allocator gets back it often keeps:
/// beside the factor that would count.
#[derive(Debug)]
pub(crate) struct Buffer<T> {
    pages: MmapMut,
    len: usize,
    of: PhantomData<T>,
}

impl<T: Pod> Buffer<T> {
    /// Zeros. Without memory for them the process ends, as for a `Vec`.
    pub(crate) fn zeros(len: usize) -> Self {
        let layout = Layout::array::<T>(len).unwrap_or(Layout::new::<T>());
        // There are no maps of length 0.
        match MmapMut::map_anon(layout.size().max(1)) {
            Ok(pages) => {
                // Fewer faults and misses of the translation buffer, if the system has large pages; as good without.
                #[cfg(target_os = "linux")]
                if layout.size() >= LARGE {
                    pages.advise(memmap2::Advice::HugePage).ok();
                }
                Self { pages, len, of: PhantomData }
            }
            Err(_) => handle_alloc_error(layout),
        }
    }
}

impl<T: Pod> Default for Buffer<T> {
    fn default() -> Self {
        Self::zeros(0)
    }
}

impl<T: Pod> Clone for Buffer<T> {
    fn clone(&self) -> Self {
        let mut copy = Self::zeros(self.len);
        copy.copy_from_slice(self);
        copy
    }
}

impl<T: Pod> Deref for Buffer<T> {
    type Target = [T];

    fn deref(&self) -> &[T] {
        bytemuck::cast_slice(&self.pages[..self.len * size_of::<T>()])
    }
}

impl<T: Pod> DerefMut for Buffer<T> {
    fn deref_mut(&mut self) -> &mut [T] {
        let bytes = self.len * size_of::<T>();
        bytemuck::cast_slice_mut(&mut self.pages[..bytes])
    }
}
