//! Many views at once: the calling thread prepares them one after the other, other threads draw them meanwhile.
//!
//! Every thread has a canvas of its own, and every view its own piece of the result, so that nothing but the list of
//! views that wait is shared.

use std::collections::VecDeque;
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};

use crate::canvas::Canvas;
use crate::error::{Error, check_len};
use crate::view::View;

/// Views that may wait for each thread; with more, the calling thread draws as well.
const MOST_WAITING: usize = 4;

/// A view and where its picture goes.
type Task<'out, T> = (View, &'out mut [T]);

/// What threads share.
struct Shared<'out, T, E> {
    state: Mutex<State<'out, T, E>>,
    news: Condvar,
}

struct State<'out, T, E> {
    waiting: VecDeque<Task<'out, T>>,
    /// No view will follow.
    is_complete: bool,
    failure: Option<E>,
}

impl<'out, T, E> Shared<'out, T, E> {
    fn new() -> Self {
        let state = State {
            waiting: VecDeque::new(),
            is_complete: false,
            failure: None,
        };
        Self {
            state: Mutex::new(state),
            news: Condvar::new(),
        }
    }

    fn lock(&self) -> MutexGuard<'_, State<'out, T, E>> {
        // Nothing that can panic happens under the lock.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Adds a view; returns how many wait.
    fn put(&self, task: Task<'out, T>) -> usize {
        let mut state = self.lock();
        state.waiting.push_back(task);
        self.news.notify_one();
        state.waiting.len()
    }

    /// The next view, if one waits now.
    fn take(&self) -> Option<Task<'out, T>> {
        self.lock().waiting.pop_front()
    }

    /// The next view as soon as there is one; `None` when there will be none.
    fn wait(&self) -> Option<Task<'out, T>> {
        let is_idle = |state: &mut State<'_, T, E>| state.waiting.is_empty() && !state.is_complete;
        let state = self.news.wait_while(self.lock(), is_idle);
        let mut state = state.unwrap_or_else(PoisonError::into_inner);
        state.waiting.pop_front()
    }

    /// Says that no view will follow.
    fn complete(&self) {
        self.lock().is_complete = true;
        self.news.notify_all();
    }

    /// Keeps the first failure, and drops what waits.
    fn fail(&self, failure: E) {
        let mut state = self.lock();
        state.waiting.clear();
        state.failure.get_or_insert(failure);
    }

    fn has_failed(&self) -> bool {
        self.lock().failure.is_some()
    }
}

/// Lets threads end, however the calling thread leaves.
struct Completes<'a, 'out, T, E>(&'a Shared<'out, T, E>);

impl<T, E> Drop for Completes<'_, '_, T, E> {
    fn drop(&mut self) {
        self.0.complete();
    }
}

/// Draws `count` views into `out`, as many values each; `canvases` are the threads' own, the first that of the caller.
///
/// `prepare` makes the views in order, on the calling thread. `detached` runs what the calling thread draws: a place
/// to let go of what only `prepare` needs. What is drawn does not depend on the number of canvases.
///
/// # Errors
/// [`Error::Length`] when `out` cannot be cut into equal parts, and the first error of `prepare` or `draw`.
///
/// # Panics
/// When `canvases` is empty.
pub fn draw_all<T: Send, E: From<Error> + Send>(
    canvases: &mut [Canvas],
    (count, out): (usize, &mut [T]),
    mut prepare: impl FnMut(usize) -> Result<View, E>,
    detached: impl Fn(&mut (dyn FnMut() + Send)),
    draw: impl Fn(&mut Canvas, &View, &mut [T]) -> Result<(), E> + Sync,
) -> Result<(), E> {
    let each = out.len().checked_div(count).unwrap_or(0);
    check_len("values of a batch", each * count, out.len())?;
    if out.is_empty() {
        return Ok(());
    }
    let most = MOST_WAITING * canvases.len();
    let (own, others) = (canvases.split_first_mut()).expect("expected a canvas to draw with");
    let shared = Shared::new();
    let finish = |canvas: &mut Canvas, (view, part): Task<'_, T>| {
        draw(canvas, &view, part).unwrap_or_else(|failure| shared.fail(failure));
    };
    let help = |canvas: &mut Canvas| {
        while let Some(task) = shared.wait() {
            finish(canvas, task);
        }
    };
    std::thread::scope(|scope| -> Result<(), E> {
        let (shared, help) = (&shared, &help);
        let completes = Completes(shared);
        let mut helpers: Vec<_> = (others.iter_mut().take(count - 1))
            .map(|canvas| scope.spawn(move || help(canvas)))
            .collect();
        for (number, part) in out.chunks_exact_mut(each).enumerate() {
            if shared.put((prepare(number)?, part)) >= most {
                detached(&mut || shared.take().into_iter().for_each(|task| finish(own, task)));
            }
            if shared.has_failed() {
                break;
            }
        }
        drop(completes);
        detached(&mut || {
            help(own);
            for helper in helpers.drain(..) {
                (helper.join()).unwrap_or_else(|panic| std::panic::resume_unwind(panic));
            }
        });
        Ok(())
    })?;
    let failure = shared.lock().failure.take();
    failure.map_or(Ok(()), Err)
}
