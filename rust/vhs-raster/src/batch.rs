//! Many views at once: threads take one view after the other, each with a canvas of its own.

use std::sync::{Mutex, PoisonError};

use crate::canvas::Canvas;
use crate::error::{Result, check_len};
use crate::view::View;

/// Draws `views` into `out`, as many values each; `canvases` are the threads' own, one a thread.
///
/// What is drawn does not depend on the number of threads.
///
/// # Errors
/// [`crate::Error::Length`] when `out` cannot be cut into equal parts, and the first error of `draw`.
///
/// # Panics
/// When `canvases` is empty and there is a view.
pub fn draw_all<T: Send>(
    canvases: &mut [Canvas],
    views: &[View],
    out: &mut [T],
    draw: impl Fn(&mut Canvas, &View, &mut [T]) -> Result<()> + Sync,
) -> Result<()> {
    let each = out.len() / views.len().max(1);
    check_len("values of a batch", each * views.len(), out.len())?;
    if out.is_empty() {
        return Ok(());
    }
    assert!(!canvases.is_empty(), "expected a canvas to draw with");
    let left = Mutex::new(views.iter().zip(out.chunks_exact_mut(each)));
    let next = || left.lock().unwrap_or_else(PoisonError::into_inner).next();
    let work = |canvas: &mut Canvas| -> Result<()> {
        while let Some((view, part)) = next() {
            draw(canvas, view, part)?;
        }
        Ok(())
    };
    let most = views.len().min(canvases.len());
    let Some((own, others)) = canvases[..most].split_first_mut() else {
        return Ok(());
    };
    std::thread::scope(|scope| {
        let work = &work;
        let helpers: Vec<_> = (others.iter_mut())
            .map(|canvas| scope.spawn(move || work(canvas)))
            .collect();
        let mut result = work(own);
        for helper in helpers {
            match helper.join() {
                Ok(found) => result = result.and(found),
                Err(panic) => std::panic::resume_unwind(panic),
            }
        }
        result
    })
}
