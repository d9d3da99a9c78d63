//! Routes of the API, with its OpenAPI description.

use std::sync::Arc;

use axum::extract::DefaultBodyLimit;
use axum::http::StatusCode;
use axum::{Json, Router, middleware};
use utoipa::OpenApi as _;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use super::backend::Backend;
use super::failure::Failure;
use super::{access, cameras, commands, events, frames, grasps, health, login, page};
use gripcast_imaging::Role;

/// Maximum size of a request body, bytes.
const MAX_BODY_BYTES: usize = 16 * 1024;

#[derive(utoipa::OpenApi)]
#[openapi(
    info(
        title = "gripcast",
        description = "The running collection: state, commands, grasps, images."
    ),
    components(schemas(events::Event, grasps::PreviewKind, Role)),
    tags(
        (name = "session", description = "Step, prediction and commands"),
        (name = "grasps", description = "Saved grasps"),
        (name = "cameras", description = "Live images"),
        (name = "daemon", description = "The daemon itself")
    )
)]
struct Description;

fn api_routes() -> OpenApiRouter<Arc<Backend>> {
    OpenApiRouter::with_openapi(Description::openapi())
        .routes(routes!(health::state))
        .routes(routes!(events::events))
        .routes(routes!(commands::command))
        .routes(routes!(commands::command_result))
        .routes(routes!(commands::object))
        .routes(routes!(commands::scene))
        .routes(routes!(commands::operator))
        .routes(routes!(grasps::list))
        .routes(routes!(grasps::objects))
        .routes(routes!(grasps::record, grasps::edit))
        .routes(routes!(grasps::file))
        .routes(routes!(grasps::preview))
        .routes(routes!(grasps::label))
        .routes(routes!(grasps::trash))
        .routes(routes!(grasps::restore))
        .routes(routes!(cameras::still))
        .routes(routes!(frames::image))
        .routes(routes!(cameras::markers))
        .routes(routes!(cameras::stream))
        .routes(routes!(health::health))
        .routes(routes!(health::model))
        .routes(routes!(login::login_state, login::login))
        .routes(routes!(login::logout))
        .routes(routes!(health::metrics))
}

/// Returns the router of all requests. Each connection adds its [`access::Peer`].
pub(crate) fn router(backend: Arc<Backend>) -> Router {
    let access = Arc::clone(&backend.access);
    let (api, description) = api_routes().split_for_parts();
    let description = Arc::new(description);
    api.route(
        "/api/openapi.json",
        axum::routing::get(move || {
            let description = Arc::clone(&description);
            async move { Json((*description).clone()) }
        }),
    )
    .route("/", axum::routing::get(page::index))
    .route("/{name}", axum::routing::get(page::file))
    .fallback(|| async { Failure::new(StatusCode::NOT_FOUND, "not found") })
    .method_not_allowed_fallback(|| async {
        Failure::new(
            StatusCode::METHOD_NOT_ALLOWED,
            "method not allowed; see /api/openapi.json",
        )
    })
    .layer(DefaultBodyLimit::max(MAX_BODY_BYTES))
    .layer(middleware::from_fn_with_state(access, access::guard))
    .with_state(backend)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// `make docs` makes the reference of the API from the snapshot.
    #[test]
    fn openapi_description_matches_snapshot() {
        let (_, description) = api_routes().split_for_parts();
        let mut settings = insta::Settings::clone_current();
        settings.set_snapshot_path("../../tests/it/snapshots");
        settings.set_prepend_module_to_snapshot(false);
        settings.set_omit_expression(true);
        let text = description.to_pretty_json().unwrap();
        settings.bind(|| insta::assert_snapshot!("openapi", text));
    }

    /// docs/reference/api.md and the OpenAPI description have the same routes.
    #[test]
    fn openapi_and_docs_have_the_same_routes() {
        let (_, description) = api_routes().split_for_parts();
        let described: Vec<String> = description.paths.paths.keys().cloned().collect();
        let document = include_str!("../../docs/reference/api.md");
        for path in &described {
            let path = path.replace(['{', '}'], "").to_uppercase();
            let is_named = document.to_uppercase().contains(&path);
            assert!(is_named, "docs/reference/api.md does not name {path}");
        }
        let rows = document.lines().filter_map(|line| line.strip_prefix("| "));
        let named: Vec<&str> = rows
            .filter_map(|row| row.split('`').nth(1))
            .filter(|text| text.contains(" /"))
            .collect();
        assert!(named.len() >= described.len(), "{} rows", named.len());
        for text in named {
            let (_, path) = text.split_once(' ').unwrap();
            let path = path.split('?').next().unwrap().to_lowercase();
            let known = described
                .iter()
                .any(|described| described.replace(['{', '}'], "").to_lowercase() == path);
            assert!(
                known || path == "/api/openapi.json",
                "{path} is not described"
            );
        }
    }
}
