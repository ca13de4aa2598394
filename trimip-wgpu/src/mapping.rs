//! A buffer on its way into the host's memory, to be waited for by blocking or as a future.

use crate::device::lock;
use std::future::poll_fn;
use std::sync::{Arc, Mutex};
use std::task::{Poll, Waker};

/// The mapping of a buffer.
pub struct Mapping(Arc<Mutex<State>>);

#[derive(Default)]
struct State {
    /// Whether it could be mapped, once that is known.
    result: Option<bool>,
    waker: Option<Waker>,
}

impl Mapping {
    /// Asks for the whole of `staging` to be mapped for reading.
    pub fn of(staging: &wgpu::Buffer) -> Self {
        let state = Arc::new(Mutex::new(State::default()));
        let told = Arc::clone(&state);
        staging.map_async(wgpu::MapMode::Read, .., move |result| {
            let mut state = lock(&told);
            state.result = Some(result.is_ok());
            if let Some(waker) = state.waker.take() {
                waker.wake();
            }
        });
        Self(state)
    }

    /// Whether the buffer could be mapped; `None` while that is not known.
    pub fn result(&self) -> Option<bool> {
        lock(&self.0).result
    }

    /// Waits until the buffer is mapped; false when it could not be. `poll` lets the device answer and returns false when
    /// it failed. A browser lets its device answer by itself and wakes the task; elsewhere the task asks again.
    pub async fn wait(&self, poll: impl Fn() -> bool) -> bool {
        poll_fn(|context| {
            let alive = poll();
            let mut state = lock(&self.0);
            if let Some(mapped) = state.result {
                return Poll::Ready(alive && mapped);
            }
            if !alive {
                return Poll::Ready(false);
            }
            state.waker = Some(context.waker().clone());
            if cfg!(not(target_family = "wasm")) {
                drop(state);
                std::thread::yield_now();
                context.waker().wake_by_ref();
            }
            Poll::Pending
        })
        .await
    }
}
