//! The mapping of a buffer into the host's memory. A thread can block until it is done, or a task can await it.

use super::lock::lock;
use std::future::poll_fn;
use std::sync::{Arc, Mutex};
use std::task::{Poll, Waker};

/// A pending or finished mapping of a buffer.
pub struct Mapping(Arc<Mutex<State>>);

#[derive(Default)]
struct State {
    /// True if the mapping succeeded; `None` while it is pending.
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

    /// Blocks until the buffer is mapped; returns false if the mapping failed. The device has already executed the copy. The
    /// result can still be pending if another thread polls the same device, because that thread may be the one that delivers
    /// the result. `poll` polls the device and returns false if the device failed.
    pub fn settle(&self, poll: impl Fn() -> bool) -> bool {
        loop {
            let result = lock(&self.0).result;
            if let Some(mapped) = result {
                return mapped;
            }
            if !poll() {
                return false;
            }
            std::thread::yield_now();
        }
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
