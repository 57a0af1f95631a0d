//! MuJoCo's arrays as slices.

/// Returns a slice of `count` values; empty for a null pointer, which empty arrays may have.
///
/// # Safety
/// The pointer is null, or points at `count` values that outlive `'a`.
pub(super) unsafe fn values<'a, T>(pointer: *const T, count: i32) -> &'a [T] {
    if pointer.is_null() || count <= 0 {
        return &[];
    }
    // SAFETY: the caller promises that the pointer points at `count` values.
    unsafe { std::slice::from_raw_parts(pointer, count as usize) }
}
