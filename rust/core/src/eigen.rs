//! Eigenvalues and eigenvectors of a symmetric matrix by Jacobi's rotations (Golub and Van Loan, Matrix Computations, 8.5). Unlike the faster
//! way of nalgebra it is exact for the small values of a positive matrix (Demmel and Veselic 1992), and covariances of calibrations have
//! values of very different size. 18 unknowns take 0.1 ms.

use nalgebra::allocator::Allocator;
use nalgebra::{DefaultAllocator, Dim, OMatrix, OVector};

/// `matrix = vectors diag(values) vectors^T`, in no order.
pub struct Eigen<D: Dim>
where
    DefaultAllocator: Allocator<D> + Allocator<D, D>,
{
    /// In no order.
    pub values: OVector<f64, D>,
    /// A column for each value.
    pub vectors: OMatrix<f64, D, D>,
}

/// Each sweep squares what is left beside the diagonal: ten are more than any matrix of this size needs.
const MOST_SWEEPS: usize = 30;

/// Of a symmetric matrix; what is not symmetric is averaged.
#[must_use]
pub fn symmetric_eigen<D: Dim>(matrix: &OMatrix<f64, D, D>) -> Eigen<D>
where
    DefaultAllocator: Allocator<D> + Allocator<D, D>,
{
    let mut m = (matrix + matrix.transpose()) * 0.5;
    let (rows, columns) = m.shape_generic();
    let mut vectors = OMatrix::<f64, D, D>::identity_generic(rows, columns);
    let size = m.nrows();
    for _ in 0..MOST_SWEEPS {
        let mut turned = false;
        for i in 0..size {
            for j in i + 1..size {
                let beside = m[(i, j)];
                if beside.abs() <= f64::EPSILON * (m[(i, i)] * m[(j, j)]).abs().sqrt() {
                    continue;
                }
                turned = true;
                // The smaller of the two turns that make the element vanish.
                let theta = (m[(j, j)] - m[(i, i)]) / (2.0 * beside);
                let tan = theta.signum() / (theta.abs() + theta.hypot(1.0));
                let cos = 1.0 / tan.hypot(1.0);
                let sin = tan * cos;
                for k in 0..size {
                    let (a, b) = (m[(k, i)], m[(k, j)]);
                    m[(k, i)] = cos * a - sin * b;
                    m[(k, j)] = sin * a + cos * b;
                    let (a, b) = (vectors[(k, i)], vectors[(k, j)]);
                    vectors[(k, i)] = cos * a - sin * b;
                    vectors[(k, j)] = sin * a + cos * b;
                }
                for k in 0..size {
                    let (a, b) = (m[(i, k)], m[(j, k)]);
                    m[(i, k)] = cos * a - sin * b;
                    m[(j, k)] = sin * a + cos * b;
                }
                m[(i, j)] = 0.0;
                m[(j, i)] = 0.0;
            }
        }
        if !turned {
            break;
        }
    }
    Eigen { values: m.diagonal(), vectors }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Matrix3, Matrix4};
    use proptest::prelude::*;

    fn recomposed<D: Dim>(matrix: &OMatrix<f64, D, D>) -> OMatrix<f64, D, D>
    where
        DefaultAllocator: Allocator<D> + Allocator<D, D>,
    {
        let Eigen { values, vectors } = symmetric_eigen(matrix);
        &vectors * OMatrix::<f64, D, D>::from_diagonal(&values) * vectors.transpose()
    }

    #[test]
    fn a_matrix_of_very_unequal_eigenvalues_is_recomposed() {
        // The matrix of nalgebra's issue 1109.
        #[rustfmt::skip]
        let m = Matrix4::new(
            -19884.07, -10.07188, 11.277279, -188560.63,
            -10.07188, 12.518197, 1.3770627, -102.97504,
            11.277279, 1.3770627, 14.587362, 113.26099,
            -188560.63, -102.97504, 113.26099, -1788112.3,
        );
        let off = |found: Matrix4<f64>| (found - m).component_div(&m).amax();
        assert!(off(recomposed(&m)) < 1e-8, "{}", off(recomposed(&m)));
        assert_eq!(recomposed(&Matrix4::<f64>::zeros()), Matrix4::zeros());
        let broken = Matrix4::repeat(f64::NAN);
        assert!(symmetric_eigen(&broken).values.iter().all(|v| v.is_nan()));
    }

    proptest! {
        #[test]
        fn values_and_vectors_are_those_of_the_matrix(
            turn in prop::array::uniform3(-3.0..3.0f64),
            sizes in prop::array::uniform3(-9.0..0.0f64)
        ) {
            let rotation = nalgebra::Rotation3::new(turn.into()).into_inner();
            let wanted = sizes.map(|s| 10f64.powf(s));
            let m = rotation * Matrix3::from_diagonal(&wanted.into()) * rotation.transpose();
            let Eigen { values, vectors } = symmetric_eigen(&m);
            for (value, vector) in values.iter().zip(vectors.column_iter()) {
                prop_assert!((m * vector - vector * *value).norm() < 1e-14, "{values:?}");
                prop_assert!(wanted.iter().any(|w| (w - value).abs() < 1e-14 + 1e-6 * w), "{values:?} {wanted:?}");
            }
            prop_assert!((vectors.transpose() * vectors - Matrix3::identity()).norm() < 1e-13);
        }
    }
}
