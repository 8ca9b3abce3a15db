//! Orthonormal directions of vectors that arrive one at a time, by Gram-Schmidt in two passes: the second removes the
//! rounding of the first (Giraud et al. 2005: twice is enough). Unlike a triangular factor, they show which vectors are
//! dependent, and dependent vectors do not change a residual.

/// Orthonormal directions.
#[derive(Debug, Clone, Default)]
pub struct OrthonormalBasis(Vec<Vec<f64>>);

/// Remainder of a vector after the directions.
#[derive(Debug, Clone, PartialEq)]
pub struct Rest {
    /// Part of the vector that is perpendicular to all directions.
    pub vector: Vec<f64>,
    /// Length of this part.
    pub length: f64,
    /// Part of the vector along each direction, in order.
    pub along: Vec<f64>,
}

impl OrthonormalBasis {
    /// Number of directions.
    #[must_use]
    pub fn rank(&self) -> usize {
        self.0.len()
    }

    /// Remainder of a vector after the directions.
    #[must_use]
    pub fn rest(&self, vector: &[f64]) -> Rest {
        let mut rest = vector.to_vec();
        let mut along = vec![0.0; self.0.len()];
        for _pass in 0..2 {
            for (direction, sum) in self.0.iter().zip(&mut along) {
                let part = dot(direction, &rest);
                rest.iter_mut().zip(direction).for_each(|(x, d)| *x -= part * d);
                *sum += part;
            }
        }
        let length = norm(&rest);
        Rest { vector: rest, length, along }
    }

    /// Adds the direction of a remainder.
    pub fn take(&mut self, rest: Rest) {
        let Rest { mut vector, length, .. } = rest;
        vector.iter_mut().for_each(|x| *x /= length);
        self.0.push(vector);
    }

    /// Adds a vector if its new part exceeds the fraction `dependent` of its length.
    pub fn add(&mut self, vector: &[f64], dependent: f64) {
        let rest = self.rest(vector);
        if rest.length > dependent * norm(vector) {
            self.take(rest);
        }
    }
}

/// Inner product of two vectors of equal length.
#[must_use]
pub fn dot(x: &[f64], y: &[f64]) -> f64 {
    x.iter().zip(y).map(|(x, y)| x * y).sum()
}

/// Length of a vector.
#[must_use]
pub fn norm(x: &[f64]) -> f64 {
    dot(x, x).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Rounding of a few operations on numbers of about one.
    const ROUNDING: f64 = 1e-14;

    #[test]
    fn a_vector_is_its_parts_and_its_rest_and_a_dependent_one_adds_nothing() {
        // nearly parallel: one pass would leave a thousand times the rounding
        let vectors = [[1.0, 1e-4, 0.0, 0.0], [1.0, 0.0, 1e-4, 0.0], [2.0, 1e-4, 1e-4, 0.0]];
        let mut basis = OrthonormalBasis::default();
        vectors.iter().for_each(|vector| basis.add(vector, 1e-8));
        assert_eq!(basis.rank(), 2);
        let vector = [0.3, -0.7, 0.2, 0.9];
        let rest = basis.rest(&vector);
        let square = rest.along.iter().map(|part| part * part).sum::<f64>() + rest.length * rest.length;
        assert!((square - dot(&vector, &vector)).abs() < ROUNDING, "{rest:?}");
        for of in vectors {
            assert!(dot(&of, &rest.vector).abs() < ROUNDING, "{rest:?}");
        }
    }
}
