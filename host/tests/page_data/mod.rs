//! What the script of a report draws.

use serde_json::Value;

/// The data of a page.
pub(crate) fn of(html: &str) -> Value {
    assert!(html.ends_with("</html>\n"), "a whole page");
    let (_, data) = html.split_once(" id=\"data\">").expect("a page has data");
    serde_json::from_str(data.split_once("</script>").expect("they end").0).expect("JSON")
}

/// Everything called so, wherever it stands.
pub(crate) fn all<'a>(data: &'a Value, name: &str) -> Vec<&'a Value> {
    match data {
        Value::Object(map) => {
            let deeper = map.values().flat_map(|value| all(value, name));
            map.get(name).into_iter().chain(deeper).collect()
        }
        Value::Array(items) => items.iter().flat_map(|item| all(item, name)).collect(),
        _ => Vec::new(),
    }
}

/// The charts, in the order of the page.
pub(crate) fn charts(data: &Value) -> Vec<&Value> {
    let one = |value: &Value| value.get("curves").is_some();
    let found = ["chart", "beside", "charts"].into_iter().flat_map(|name| all(data, name));
    let list = found.flat_map(|value| value.as_array().map_or(vec![value], |items| items.iter().collect()));
    list.filter(|value| one(value)).collect()
}
