//! Where what rays meet is written.

use crate::error::GeometryError;

/// Planes of a frame, or of several one behind the other; each is optional and has one entry for each ray.
#[derive(Debug, Default)]
pub struct Planes<'a> {
    /// Distance as the rule of the frame states it, m: 0 for less than its least, infinite for more than its greatest and for nothing.
    pub depth: Option<&'a mut [f32]>,
    /// 0 for a surface, 1 for none, 2 for one beyond the greatest distance, 3 for one nearer than the least.
    pub status: Option<&'a mut [u8]>,
    /// Geom that was met, −1 for none.
    pub geom: Option<&'a mut [i32]>,
    /// Its body, −1 for none.
    pub body: Option<&'a mut [i32]>,
    /// Outward unit normal in the world, zero for none.
    pub normal: Option<&'a mut [[f32; 3]]>,
}

impl<'a> Planes<'a> {
    /// Every plane has one entry for each ray.
    ///
    /// # Errors
    /// [`GeometryError::Shape`], naming the plane.
    pub fn check(&self, rays: usize) -> Result<(), GeometryError> {
        let check = |what, found: Option<usize>| match found {
            Some(found) if found != rays => {
                Err(GeometryError::Shape { what, shape: format!("({rays} rays)"), expected: rays, found })
            }
            _ => Ok(()),
        };
        check("depths", self.depth.as_ref().map(|p| p.len()))?;
        check("states", self.status.as_ref().map(|p| p.len()))?;
        check("geoms", self.geom.as_ref().map(|p| p.len()))?;
        check("bodies", self.body.as_ref().map(|p| p.len()))?;
        check("normals", self.normal.as_ref().map(|p| p.len()))
    }

    /// The planes of `n` consecutive images, or groups of them, of `size` pixels each.
    pub fn chunks(self, size: usize, n: usize) -> impl Iterator<Item = Planes<'a>> {
        let mut depth = self.depth.map(|p| p.chunks_mut(size));
        let mut status = self.status.map(|p| p.chunks_mut(size));
        let mut geom = self.geom.map(|p| p.chunks_mut(size));
        let mut body = self.body.map(|p| p.chunks_mut(size));
        let mut normal = self.normal.map(|p| p.chunks_mut(size));
        (0..n).map(move |_| Planes {
            depth: depth.as_mut().and_then(Iterator::next),
            status: status.as_mut().and_then(Iterator::next),
            geom: geom.as_mut().and_then(Iterator::next),
            body: body.as_mut().and_then(Iterator::next),
            normal: normal.as_mut().and_then(Iterator::next),
        })
    }

    /// The same planes, lent.
    pub fn reborrow(&mut self) -> Planes<'_> {
        Planes {
            depth: self.depth.as_deref_mut(),
            status: self.status.as_deref_mut(),
            geom: self.geom.as_deref_mut(),
            body: self.body.as_deref_mut(),
            normal: self.normal.as_deref_mut(),
        }
    }
}
