//! The camera models on a GPU, in the order of [`trimip_core::geometry::projections`]: the WGSL of each model defines
//! `cone_NAME`, and `cone_of_model` calls the function of a view's model.

/// Joins the files of the models, and writes `cone_of_model`. Each line has a value of a view's `lens`, and the name of
/// the model that it stands for.
macro_rules! models {
    ($($number:literal => $name:literal),+ $(,)?) => {
        /// WGSL of all models.
        pub const PROJECTIONS: &str = concat!(
            $(include_str!(concat!("shaders/projections/", $name, ".wgsl")), "\n",)+
            "fn cone_of_model(view: View, at: vec2<f32>, side: f32) -> LocalCone {\n    switch view.lens {\n",
            $("        case ", $number, "u: { return cone_", $name, "(view, at, side); }\n",)+
            "        default: { return no_cone(); }\n    }\n}\n",
        );

        #[cfg(test)]
        const MODELS: &[(u32, &str)] = &[$(($number, $name)),+];
    };
}

models! {
    1 => "perspective",
    2 => "fisheye",
    3 => "orthographic",
    4 => "equirectangular",
}

#[cfg(test)]
mod tests {
    use super::*;
    use trimip_core::geometry::projections::Model;

    #[test]
    fn models_have_the_numbers_of_core() {
        let expected: Vec<_> = Model::ALL.iter().map(|model| (1 + *model as u32, model.name())).collect();
        assert_eq!(MODELS, expected);
    }
}
