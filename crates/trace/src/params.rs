//! Parameters of a formula as plain structs over a number type, whose every scalar can be visited by name.
//!
//! A fit turns one of them into a dual, a randomised reset draws one of them anew, a trace makes one of them a graph
//! input: all three go through [`Parameters`].

use crate::Real;

/// A parameter or a group of parameters over the number type `S`.
pub trait Parameters<S: Real> {
    /// The same parameters over another number type.
    type Over<T: Real>;

    /// Every scalar through `f`, in order of declaration.
    fn map<T: Real>(&self, f: &mut dyn FnMut(S) -> T) -> Self::Over<T>;

    /// `f(name, value)` for every scalar; names are `prefix.field`, and `prefix.field.index` in arrays.
    fn visit(&mut self, prefix: &str, f: &mut dyn FnMut(&str, &mut S));

    /// Every scalar in the order of [`Parameters::map`], without names: for what is done often.
    fn numbers<F: FnMut(S)>(&self, f: &mut F);

    /// The same, to change them.
    fn numbers_mut<F: FnMut(&mut S)>(&mut self, f: &mut F);
}

impl<S: Real> Parameters<S> for S {
    type Over<T: Real> = T;
    fn map<T: Real>(&self, f: &mut dyn FnMut(S) -> T) -> T {
        f(*self)
    }
    fn visit(&mut self, prefix: &str, f: &mut dyn FnMut(&str, &mut S)) {
        f(prefix, self);
    }
    #[inline(always)]
    fn numbers<F: FnMut(S)>(&self, f: &mut F) {
        f(*self);
    }
    #[inline(always)]
    fn numbers_mut<F: FnMut(&mut S)>(&mut self, f: &mut F) {
        f(self);
    }
}

impl<S: Real, P: Parameters<S>, const N: usize> Parameters<S> for [P; N] {
    type Over<T: Real> = [P::Over<T>; N];
    fn map<T: Real>(&self, f: &mut dyn FnMut(S) -> T) -> Self::Over<T> {
        core::array::from_fn(|i| self[i].map(f))
    }
    fn visit(&mut self, prefix: &str, f: &mut dyn FnMut(&str, &mut S)) {
        for (i, item) in self.iter_mut().enumerate() {
            item.visit(&format!("{prefix}.{i}"), f);
        }
    }
    #[inline(always)]
    fn numbers<F: FnMut(S)>(&self, f: &mut F) {
        self.iter().for_each(|item| item.numbers(f));
    }
    #[inline(always)]
    fn numbers_mut<F: FnMut(&mut S)>(&mut self, f: &mut F) {
        self.iter_mut().for_each(|item| item.numbers_mut(f));
    }
}

/// Declares a parameter struct over a number type `S` with its [`Parameters`] implementation. Fields after `fixed:` are
/// copied, not visited (counts and switches).
#[macro_export]
macro_rules! parameters {
    (
        $(#[$meta:meta])*
        pub struct $name:ident {
            $($(#[$fmeta:meta])* $field:ident: $ty:ty,)*
            $(; fixed: $($(#[$xmeta:meta])* $fixed:ident: $xty:ty,)*)?
        }
    ) => {
        $(#[$meta])*
        #[derive(Clone, Copy, Debug, PartialEq)]
        pub struct $name<S> {
            $($(#[$fmeta])* pub $field: $ty,)*
            $($($(#[$xmeta])* pub $fixed: $xty,)*)?
        }

        impl<S: $crate::Real> $crate::params::Parameters<S> for $name<S> {
            type Over<T: $crate::Real> = $name<T>;
            #[allow(unused_variables)]
            fn map<T: $crate::Real>(&self, f: &mut dyn FnMut(S) -> T) -> $name<T> {
                use $crate::params::Parameters;
                $name {
                    $($field: Parameters::<S>::map(&self.$field, f),)*
                    $($($fixed: self.$fixed,)*)?
                }
            }
            #[allow(unused_variables)]
            fn visit(&mut self, prefix: &str, f: &mut dyn FnMut(&str, &mut S)) {
                use $crate::params::Parameters;
                $(Parameters::<S>::visit(&mut self.$field, &format!("{prefix}.{}", stringify!($field)), f);)*
            }
            #[inline]
            #[allow(unused_variables)]
            fn numbers<F: FnMut(S)>(&self, f: &mut F) {
                $($crate::params::Parameters::<S>::numbers(&self.$field, f);)*
            }
            #[inline]
            #[allow(unused_variables)]
            fn numbers_mut<F: FnMut(&mut S)>(&mut self, f: &mut F) {
                $($crate::params::Parameters::<S>::numbers_mut(&mut self.$field, f);)*
            }
        }
    };
}
pub use parameters;
