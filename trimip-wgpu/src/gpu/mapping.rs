//! The mapping of a buffer into the host's memory, which can be awaited by blocking or as a future.

use super::lock::lock;
use std::future::poll_fn;
use std::sync::{Arc, Mutex};
use std::task::{Poll, Waker};

/// A pending or finished mapping of a buffer.
pub struct Mapping(Arc<Mutex<State>>);

#[derive(Default)]
struct State {
    /// Whether the mapping succeeded; `None` while it is pending.
    result: Option<bool>,
    waker: Option<Waker>,
}

impl Mapping {
    /// Requests a mapping of the whole of `staging` for reading.
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

    /// Whether the mapping succeeded; `None` while it is pending.
    pub fn result(&self) -> Option<bool> {
        lock(&self.0).result
    }

    /// Waits until the buffer is mapped; returns false if the mapping failed. `poll` polls the device and returns
    /// false if the device failed. A browser polls its device itself and wakes the task; elsewhere the task polls
    /// again.
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
