//! Orders of convergence.

/// Order of convergence between successive levels: ln(e₀/e₁) / ln(h₀/h₁).
pub fn orders(sizes: &[f64], errors: &[f64]) -> Vec<f64> {
    (1..errors.len()).map(|i| (errors[i - 1] / errors[i]).ln() / (sizes[i - 1] / sizes[i]).ln()).collect()
}
