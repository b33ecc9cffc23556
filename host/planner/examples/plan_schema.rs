//! Prints the JSON schema of plan files, made from the types:
//!
//! ```sh
//! cargo run -p planner --example plan_schema > host/planner/schemas/plan.schema.json
//! ```

fn main() {
    print!("{}", planner::record::schema_json());
}
